"""The command that makes the page on which a visitor is the person."""

import webbrowser
from pathlib import Path

from assistax_zoo.shell.console import answer, stdout_is_data

PAGE = ".html"
LARGE = 1_000_000  # bytes


def play(
    task: str,
    *,
    robot: list[str] | None = None,
    out: Path | None = None,
    open: bool = True,
    study: bool = False,
    registry: str | None = None,
    json: bool = False,
) -> None:
    """Be the person of a task: a page in which you play with a robot, by mouse, finger or keys.

    The page is one file. It simulates the task as this installation does, loads nothing from
    elsewhere and sends nothing. An episode can be saved as a log, which `replay` checks.

    Args:
        task: A gentle task, such as gentle_feeding.
        robot: A robot to choose from: an id, script, or told-script, which is told the wish.
            Give it once for each. The two scripts and a published robot if not given.
        out: Page to write; play-TASK.html if not given.
        open: Open the page in a browser.
        study: Play robots blind, as A, B and C, in blocks with one start and one wish.
        registry: Registry to read instead of the installed one: a file, a folder or an address.
        json: Print one JSON document instead of text.

    Example:
        assistax-zoo play gentle_feeding --no-open
    """
    with stdout_is_data():
        from evaluation.film import check_place
        from evaluation.seat.page import default_robots, network_of, published, write_page

        path = out or Path(f"play-{task}{PAGE}")
        if path.suffix.lower() != PAGE:
            raise ValueError(f"{path.name} ends in {path.suffix or 'nothing'!r}; allowed is {PAGE}")
        network = network_of(task)
        check_place(path)
        from assistax_zoo.zoos import open_zoo

        entries = open_zoo(registry).registry
        names = robot or default_robots(entries, task, network)
        robots = published(entries, names, network)
        write_page(task, robots, path, study=study)
        size = path.stat().st_size
        if open:
            webbrowser.open(path.resolve().as_uri())
    content = {"page": str(path), "bytes": size, "robots": [one.name for one in robots]}
    lines = [str(path)]
    if size > LARGE:
        lines.append(f"It has {size / 1e6:.1f} MB: each robot adds half of one.")
    answer(json, content, *lines)
