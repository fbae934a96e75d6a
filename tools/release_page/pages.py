"""A page and its figures on disk: written, or compared with the files there."""

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path


def relative_folder(images: Path, page: Path) -> str:
    """Return the folder of the figures as the page links to it."""
    return Path(os.path.relpath(images, page.parent)).as_posix()


def relinked(text: str, source: Path, page: Path) -> str:
    """Return Markdown with relative links, written for the folder `source`, as links of a page."""

    def link(found: re.Match[str]) -> str:
        return "](" + Path(os.path.relpath(source / found[1], page.parent)).as_posix()

    return re.sub(r"\]\((?![\w+.-]+:|#)([^)#\s]+)", link, text)


def first_difference(text: str, expected: str) -> str:
    """Say where two pages differ first."""
    pairs = zip(text.splitlines(), expected.splitlines(), strict=False)
    for number, (line, other) in enumerate(pairs, start=1):
        if line != other:
            return f"line {number} is {line[:90]!r}, not {other[:90]!r}"
    return f"it has {len(text.splitlines())} lines, not {len(expected.splitlines())}"


def check_pages(
    files: Mapping[Path, str], folder: Path, pictures: Iterable[str], again: str
) -> None:
    """Check that a page and the files beside it have these texts, and that its pictures are there.

    Raises:
        ValueError: it is not so; the message says to run `again`.
    """
    for path, text in files.items():
        if not path.is_file():
            raise ValueError(f"{path} does not exist; {again}")
        if (written := path.read_text(encoding="utf-8")) != text:
            raise ValueError(
                f"{path} is not what the tables give: {first_difference(written, text)}; {again}"
            )
    if missing := [name for name in pictures if not (folder / name).is_file()]:
        raise ValueError(f"{folder} lacks {', '.join(missing)}; {again}")
