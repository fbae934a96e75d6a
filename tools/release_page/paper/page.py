"""The whole page: sections in order, hand-written reasons in their places."""

from collections.abc import Mapping
from typing import Any

from tools.release_page.data import Played
from tools.release_page.making import HEADINGS, commands, cost_rows
from tools.release_page.markdown import code, csv_of, csv_table, spoken
from tools.release_page.paper import population, sections
from tools.release_page.paper.claims import check_claims
from tools.release_page.paper.data import Results

_NO_REASONS = ("summary", "made")  # sections without figures of the paper


def make_page(results: Results, pictures: str, command: str) -> str:
    """Return the page as Markdown.

    Args:
        results: The release's data.
        pictures: Folder of the figures, relative to the page.
        command: The command that makes the page, for its last section.
    """
    claims = check_claims(results)

    def picture(name: str) -> str:
        return f"{pictures}/{name}"

    parts = {
        "summary": ("In short", sections.summary(results, claims)),
        "population": (
            "The population: Table 6 and Figure 2",
            population.population(results, picture),
        ),
        "self-play": ("Self-play: Table 2", sections.self_play(results)),
        "curves": ("Learning curves: Figure 3", sections.curves(results, picture)),
        "cross-play": ("Cross-play: Figures 4 and 5", sections.cross_play(results, picture)),
        "zsc": ("Zero-shot coordination: Figures 6 and 14", sections.zero_shot(results, picture)),
        "claims": (
            "The paper's claims, criterion by criterion",
            f"[claims.csv]({results.release}/claims.csv) has every criterion: what was found, its "
            f"threshold and the outcome.\n\n{sections.CLAIM_WORDS}",
        ),
        "made": (
            "How this was made",
            f"[minutes.csv]({results.release}/minutes.csv) has the device minutes of every part, "
            f"[commands.txt]({results.release}/commands.txt) its command. This command makes the "
            f"page:\n\n{code(command)}",
        ),
    }
    texts = [_head(results)]
    for key, (title, text) in parts.items():
        note = results.notes.get(key)
        label = "Note" if key in _NO_REASONS else "Why"
        texts.append(f"## {title}\n\n{text}" + (f"\n\n**{label}.** {note}" if note else ""))
    return "\n\n".join(texts) + "\n"


def tables(results: Results) -> dict[str, str]:
    """Return the files beside the page, in a folder named after the release."""
    trained, played = _made(results)
    lines = commands(trained, played)
    beside = {
        "claims.csv": sections.claim_table(check_claims(results)),
        "self-play.csv": sections.self_play_table(results),
        "curves.csv": sections.curve_table(results),
        "egos.csv": sections.zero_shot_table(results),
    }
    return {name: csv_of(found, "release", results.release) for name, found in beside.items()} | {
        "minutes.csv": csv_table(HEADINGS, cost_rows(results.humans, trained, played)),
        "commands.txt": "".join(f"{line}\n" for line in lines),
    }


def _head(results: Results) -> str:
    return (
        f"# Release {results.release} beside the paper\n\n"
        f"Our figures beside those of *{results.paper['source']}*. IQM and 95% bootstrap interval "
        "unless it says otherwise. This page is made from committed tables by the command at its "
        "end; only what begins with **Why** or **Note** is written by hand. In these tables all "
        "partners played the same starts, so no interval here speaks of other starts."
    )


def _made(results: Results) -> tuple[dict[str, Mapping[str, Any]], dict[str, Played]]:
    """Return trainings and plays, as `cost_rows` takes them."""
    named: dict[str, Played] = {
        f"cross-play of {spoken(task)}": played for task, played in results.crossplay.items()
    }
    named |= {
        f"evaluation of {m.upper()} egos, {spoken(t)}": egos
        for (t, m), egos in results.egos.items()
    }
    trained: dict[str, Mapping[str, Any]] = {
        f"{spoken(task)} {method.upper()} egos": egos.training
        for (task, method), egos in results.egos.items()
        if egos.training
    }
    return trained, named
