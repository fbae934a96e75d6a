"""The league: any of its rows from nothing, the tables and figures of its page, and robots' cards.

Run from a checkout: `python -m tools.league rows`, `row`, `queue`, `page` and `cards`.
"""

import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError

PROGRAM = "python -m tools.league"
SEEDS = {"gentle_lift": "64"}  # of which seeds differ most; 32 elsewhere


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0 when done, 1 after an error, 2 after wrong usage.

    Args:
        arguments: Words of the command line; this process's own if None.
    """
    app = App(name=PROGRAM, help=__doc__)
    for command in (rows, row, queue, page, cards):
        app.command(command)
    words = sys.argv[1:] if arguments is None else arguments
    try:
        app(words, print_error=False, exit_on_error=False, result_action="return_value")
    except CycloptsError as error:
        print(f"error: {error}\ntry: {PROGRAM} --help", file=sys.stderr)
        return 2
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def rows() -> None:
    """Print the rows that can be made, in the league's order."""
    from tools.league.rows import rows as known

    for made in known().values():
        print(f"{made.name:20} {made.source}{', told' * bool(made.told)}")


def row(
    name: str,
    task: str,
    /,
    *,
    out: Path,
    split: str | None = None,
    seeds: str | None = None,
    part: str | None = None,
    steps: str = "50M",
    episodes: int | None = None,
    seed: int = 0,
    checkpoints: int = 10,
    best_of: int = 4,
    sampled: int = 16,
    side: Literal["test", "train"] = "test",
    persons: int | None = None,
    validators: int | None = None,
    references: bool = True,
    contrasts: Path | None = None,
    backend: str = "auto",
    max_envs: int | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    registry: Path | None = None,
) -> None:
    """Make a row from nothing: train, choose by the validation side, play the test side.

    OUT/TASK/ROW is the evaluation with the test side, and OUT/TASK/runs/ROW has the trainings, the
    validation and row.json: seeds, steps, command and device minutes. An interrupted row continues.

    Args:
        name: Row, such as ppo; `rows` prints them.
        task: Task, such as gentle_scratch.
        out: Folder of the league.
        split: Split of three sides, or persons; default the release's own. If teams stand beside
            persons on its test side, robots train with persons and play both, but best responses,
            the mirror and robots that are told numbers play the persons alone.
        seeds: How many, or which; default 32, and 64 in gentle_lift.
        part: 2/4 trains the second quarter of the seeds, and chooses by the validation side. all/4
            joins the four, which may come from several machines, and plays the test side.
        steps: Environment steps of each robot, such as 50M.
        episodes: Of each pair; default the task's.
        seed: Seed of the episodes.
        checkpoints: At how many equal steps the validation side is played.
        best_of: Seeds of a group; the best of each group is a robot of the row ppo-best-of-4.
        sampled: Partners of the side that have best responses.
        side: Side of these partners. With those of the training side the best robots of all
            methods in OUT play too, and the folder is OUT/TASK/training-side.
        persons: How many persons of the test side play, and teams as many as of a group of them.
        validators: How many of the validation side; default as many.
        references: Whether zero, random and script play too; once in a league is enough.
        contrasts: File of named contrasts, whose sha256 the record keeps.
        backend: Physics.
        max_envs: Most simulations in a saved part of an evaluation.
        set_: Another hyperparameter, such as num_envs=1024; repeat it for more.
        registry: Registry to read instead of the installed one.

    Example:
        python -m tools.league row ppo gentle_scratch --out league
    """
    from assistax_zoo.commands.options import parse_changes, parse_seeds, parse_steps
    from evaluation.play.how import PlaySettings
    from tools.league.making import Making, Sizes, make_row
    from tools.league.parts import Part
    from tools.league.rows import named
    from zoo.registry import load_registry

    parts = Part.parse(part) if part else None
    made, how = named(name), PlaySettings(task, episodes, seed, backend, max_envs=max_envs)
    loaded = load_registry(registry)
    sizes = Sizes(
        seeds=tuple(parse_seeds(seeds or SEEDS.get(task, "32"))),
        steps=parse_steps(steps),
        best_of=best_of,
        checkpoints=checkpoints,
        sampled=sampled,
        persons=persons,
        validators=validators or persons,
        references=references,
        changes=parse_changes(set_),
    )
    command = shlex.join([*PROGRAM.split(), *sys.argv[1:]])
    chosen, folder = loaded.split(task, split), out / task
    if split is None and not chosen.validation:
        chosen = loaded.split(task, "three-sides")
    making = Making(loaded, made, how, chosen, sizes, folder, command, contrasts, side, parts)
    record = make_row(making)
    print(json.dumps(record, indent=1))


def queue(file: Path, /, *, out: Path) -> None:
    """Make many rows on all GPUs of this host, several side by side on each.

    Each line of FILE has the GB of memory that JAX takes for a row, and the words of `row`.
    OUT/logs has the output of each row. After an interruption the same command continues.

    Args:
        file: The queue.
        out: Folder of the league.

    Example:
        python -m tools.league queue queue.txt --out league
    """
    from tools.league.queue import cards_here, read_queue, run_queue

    for line in run_queue(read_queue(file), out, cards_here()):
        print(line, flush=True)


def page(
    folder: Path,
    /,
    *,
    out: Path | None = None,
    images: Path | None = None,
    contrasts: Path | None = None,
    text: Path | None = None,
    earlier: Path | None = None,
) -> None:
    """Write the results' page, its tables as CSV, and its figures.

    Args:
        folder: Of the league, which `row` fills.
        out: Folder of the tables; FOLDER/page if not given.
        images: Folder of the figures; that of the tables if not given.
        contrasts: File of named contrasts.
        text: Page to write; if not given, no page is written.
        earlier: Tables of an earlier page; its rows are shown too if FOLDER lacks them.

    Example:
        python -m tools.league page league --contrasts contrasts.toml --text league/page/page.md
    """
    from tools.league.page import write_page

    out = out or folder / "page"
    for path in write_page(folder, out, images or out, contrasts, text, earlier):
        print(path)


def cards(
    pattern: str = "*-ego-*", /, *, out: Path = Path("cards"), persons: int = 200, steps: int = 500
) -> None:
    """Write a card with M_test and a film for each published robot, and a page that lists them.

    Args:
        pattern: Glob over robots.
        out: Folder; cards and films that it has are not made again.
        persons: Most persons that play with a robot.
        steps: Steps of 20 ms in a film.

    Example:
        python -m tools.league cards 'gentle_scratch/*' --out cards
    """
    from tools.league.cards import write_cards

    for path in write_cards(pattern, out, persons, steps):
        print(path)


if __name__ == "__main__":
    sys.exit(run())
