"""The whole page: sections in order, hand-written reasons in their places."""

import os
from collections.abc import Sequence
from pathlib import Path

from tools.paper_page import sections
from tools.paper_page.claims import check_claims
from tools.paper_page.data import Results
from tools.paper_page.making import made

_NO_REASONS = ("summary", "made")  # sections that set nothing beside the paper's figures


def make_page(results: Results, pictures: str, command: str) -> str:
    """Return the page as Markdown.

    Args:
        results: what there is of the release.
        pictures: folder of the figures, relative to the page.
        command: the command that makes the page, for its last section.
    """
    claims = check_claims(results)

    def picture(name: str) -> str:
        return f"{pictures}/{name}"

    parts = {
        "summary": ("In short", sections.summary(results, claims)),
        "population": (
            "The population: Table 6 and Figure 2",
            sections.population(results, picture),
        ),
        "self-play": ("Self-play: Table 2", sections.self_play(results)),
        "curves": ("Learning curves: Figure 3", sections.curves(results, picture)),
        "cross-play": ("Cross-play: Figures 4 and 5", sections.cross_play(results, picture)),
        "zsc": ("Zero-shot coordination: Figures 6 and 14", sections.zero_shot(results, picture)),
        "claims": ("The paper's claims, criterion by criterion", sections.claim_table(claims)),
        "made": ("How this was made", made(results, command)),
    }
    texts = [_head(results)]
    for key, (title, text) in parts.items():
        note = results.notes.get(key)
        label = "Note" if key in _NO_REASONS else "Why"
        texts.append(f"## {title}\n\n{text}" + (f"\n\n**{label}.** {note}" if note else ""))
    return "\n\n".join(texts) + "\n"


def relative_folder(images: Path, page: Path) -> str:
    """Return the folder of the figures as the page links to it."""
    return Path(os.path.relpath(images, page.parent)).as_posix()


def first_difference(found: str, wanted: str) -> str:
    """Say where two pages differ first."""
    pairs = zip(found.splitlines(), wanted.splitlines(), strict=False)
    for number, (one, other) in enumerate(pairs, start=1):
        if one != other:
            return f"line {number} is {one[:90]!r}, not {other[:90]!r}"
    return f"it has {len(found.splitlines())} lines, not {len(wanted.splitlines())}"


def check_page(out: Path, text: str, folder: Path, pictures: Sequence[str], again: str) -> None:
    """Check that a page is this text and that its pictures are in the folder.

    Raises:
        ValueError: it is not so; the message says to run `again`.
    """
    if not out.is_file():
        raise ValueError(f"{out} does not exist; {again}")
    if (found := out.read_text(encoding="utf-8")) != text:
        raise ValueError(
            f"{out} is not what the tables give: {first_difference(found, text)}; {again}"
        )
    if missing := [name for name in pictures if not (folder / name).is_file()]:
        raise ValueError(f"{folder} lacks {', '.join(missing)}; {again}")


def _head(results: Results) -> str:
    return (
        f"# Release {results.release} beside the paper\n\n"
        f"Our figures beside those of *{results.paper['source']}*. IQM and 95% bootstrap interval "
        "unless it says otherwise. This page is made from committed tables by the command at its "
        "end; only what begins with **Why** or **Note** is written by hand. In these tables all "
        "partners played the same starts, so no interval here speaks of other starts."
    )
