"""Cards of published robots: returns with strangers, a film, and commands."""

from pathlib import Path

from assistax_base.files import atomic_write
from assistax_zoo.results import EvaluationResult, brief, load_result
from assistax_zoo.shell.main import run
from evaluation.cast.cast import choose_partners
from tools.release_page.markdown import table
from zoo.registry import load_registry

FILM = ("--width", "480", "--height", "360", "--fps", "10")


def write_cards(pattern: str, out: Path, persons: int, steps: int) -> list[Path]:
    """Write a card with its film for each robot, and a page of all; return their paths.

    Each plays with the test side of the split that it learned with, and is filmed with the first
    partner of that side. Existing results are not made again.

    Args:
        pattern: Glob over robots of the installed registry that learned with a split's partners.
        out: Folder.
        persons: Most persons that play with a robot.
        steps: Steps of the film.

    Raises:
        ValueError: No robot matches, or a command failed; its error has been printed.
    """
    registry = load_registry()
    robots = [robot for robot in registry.select(pattern, role="robot") if robot.trained_against]
    if not robots:
        raise ValueError(f"no robot that learned with a split's partners matches {pattern!r}")
    written, lines = [], []
    for robot in robots:
        assert robot.trained_against is not None
        split, task = robot.trained_against.split, robot.task
        folder = out / robot.team.replace("/", "-")
        film, card, result = folder / "film.webp", folder / "card.md", folder / "result"
        manifest, partners = choose_partners(registry, task, f"{split}:test", None)
        many = ["--persons", str(persons)] if registry.source_of_split(manifest).word else []
        played = ["--task", task, robot.id, "--split", split, *many, "--no-references"]
        _run("evaluate", *played, "--out", str(result))
        if not film.is_file():
            seats = ["--robot", robot.id, "--human", partners[0].id, "--steps", str(steps)]
            _run("render", "--task", task, *seats, *FILM, "--out", str(film))
        shown = ["--card", str(card), "--image", str(film), "--result", str(result)]
        _run("show", robot.id, *shown)
        found = load_result(result)
        assert isinstance(found, EvaluationResult) and found.m_test
        place = card.relative_to(out).as_posix()
        lines.append((f"[{robot.team}]({place})", f"`{split}`", brief(found.m_test)))
        written.append(card)
    page = out / "README.md"
    text = table(["robot", "learned with the training side of", "M_test on its test side"], lines)
    atomic_write(page, f"# Robots\n\n{text}\n".encode())
    return [*written, page]


def _run(*words: str) -> None:
    if run(words):
        raise ValueError(f"{words[0]} failed; mend that and repeat the command")
