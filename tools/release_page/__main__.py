"""The results of a release: condensed tables, and the page made from them.

Run from a checkout: `python -m tools.release_page collect`, `cluster` and `page`.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError

if TYPE_CHECKING:
    from zoo.registry import Registry

PROGRAM = "python -m tools.release_page"
DPI = 130  # a 198 x 198 matrix keeps more than three points a cell


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0 when done, 1 after an error, 2 after wrong usage.

    Args:
        arguments: Words of the command line; this process's own if None.
    """
    app = App(name=PROGRAM, help=__doc__)
    for command in (collect, cluster, page):
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


def page(
    *,
    release: str,
    data: Path,
    out: Path,
    images: Path | None = None,
    check: bool = False,
    registry: Path | None = None,
) -> None:
    """Write the page of a release's results, with its figures.

    A release of the paper's tasks stands beside the paper, one of gentle tasks beside the diversity
    of v1, whose tables are looked for beside the release's. Whatever is not measured yet is named
    in the page, and counted on standard error.

    Args:
        release: Release, such as v1.
        data: Folder of the release's tables, which `collect` fills.
        out: Page to write, .md.
        images: Folder for the figures; default images/RELEASE beside the page.
        check: Write nothing; fail if the page is not what would be written, or lacks a figure.
        registry: Registry to read instead of the installed one.

    Example:
        python -m tools.release_page page --release v1 --data docs/data/v1 --out v1.md
    """
    from tools.release_page.pages import check_pages, relative_folder
    from zoo.registry import load_registry

    if out.suffix.lower() != ".md":
        raise ValueError(
            f"{out.name} ends in {out.suffix or 'nothing'!r}; the page is written as .md"
        )
    folder = images or out.parent / "images" / release
    published = load_registry(registry)
    questions = questions_of(published, release)
    results = questions.read_results(published, release, data)
    places = f"--data {data.as_posix()} --out {out.as_posix()}"
    if images:
        places += f" --images {images.as_posix()}"
    command = f"{PROGRAM} page --release {release} {places}"
    text = questions.make_page(results, relative_folder(folder, out), command)
    figures = questions.figures(results)
    files = {out: text} | {
        out.parent / release / name: table for name, table in questions.tables(results).items()
    }
    if check:
        check_pages(files, folder, figures, f"run `{command}`")
    else:
        from evaluation.plots.style import save_figure
        from evaluation.record.tables import write_bytes

        for name, draw in figures.items():
            save_figure(draw(), folder / name, DPI)
        for path, content in files.items():
            write_bytes(content.encode(), path)
    for what in results.missing:
        print(f"warning: not measured yet: {what}", file=sys.stderr)
    if results.missing:
        print(f"{len(results.missing)} warnings", file=sys.stderr)
    print(f"{out} is what the tables give" if check else out)


def questions_of(registry: "Registry", release: str) -> ModuleType:
    """Return what a release's page asks: `read_results`, `make_page`, `tables` and `figures`."""
    from assistax_envs.versions import GENTLE_TASKS
    from tools.release_page import gentle, paper
    from tools.release_page.data import read_humans

    return gentle if read_humans(registry, release, GENTLE_TASKS) else paper


def collect(
    folders: tuple[Path, ...],
    /,
    *,
    out: Path,
    method: Annotated[str | None, Parameter(name="--as")] = None,
    split: str | None = None,
) -> None:
    """Condense folders of crossplay, evaluate --split both and train-ego into a release's tables.

    A row an episode becomes a row a pair, of gentle tasks a row a pair and preference; no path of a
    machine is kept.

    Args:
        folders: Finished folders; each is recognised by what it holds.
        out: Folder of the release's tables.
        method: Name of the method of all these folders on a gentle task, such as ppo-gru, ppo-told,
            or ppo-mirror of egos trained with the test side; without it, the one in the egos' file
            names. "script" and "random" take an evaluation's references.
        split: Split under which a training is filed; without it, the one that was trained with.
            Give it for ppo-mirror, whose own split has the sides exchanged.

    Example:
        python -m tools.release_page collect runs/eval-gru runs/ego-gru --as ppo-gru
        --out docs/data/v2
    """
    from tools.release_page.collect import collect as condense

    if not folders:
        raise ValueError(
            "no folder given; name at least one of crossplay, evaluate --split both or train-ego"
        )
    for folder in folders:
        written = condense(folder, out, method, split)
        size = sum(path.stat().st_size for path in written.iterdir())
        print(f"{folder} -> {written}, {size / 1e6:.2f} MB")


def cluster(
    tasks: tuple[str, ...],
    /,
    *,
    data: Path,
    release: str,
    held_out: str | None = None,
    test_preferences: str = "",
    default: bool = False,
    registry: Path | None = None,
) -> None:
    """Write the split by behaviour: one of two groups of humans is held out.

    Humans are in one group where the same robots of the release's cross-play suit them. Held out is
    the group whose own robots earn more with it: a convention that the training side lacks.

    Args:
        tasks: Gentle tasks whose cross-plays have been collected.
        data: Folder of the release's tables, which `collect` fills.
        release: Release of the partners, such as v2.
        held_out: Algorithm that is held out as well: its humans of that group are the test side,
            all others' of the other group the training side.
        test_preferences: What the test side's humans like, such as p1,p5,p9; the others like the
            rest.
        default: Make it the release's default split of the task.
        registry: Registry to write to; default your own splits, or with $ASSISTAX_ZOO_MAKER the
            installed one.

    Example:
        python -m tools.release_page cluster gentle_bath --release v2 --data docs/data/v2
    """
    from assistax_zoo.commands.options import parse_names
    from evaluation.figures.clustering import conventions
    from tools.release_page.data import CROSSPLAY, read_crossplay
    from zoo.ids import parse_team
    from zoo.splitting.create import create_split

    for task in tasks:
        played = read_crossplay(data / CROSSPLAY / task)
        held = conventions(played.matrix)
        train, test = (
            [
                team
                for team, own in zip(played.teams, held, strict=True)
                if own == side
                and (held_out is None or (parse_team(team).algorithm == held_out) == side)
            ]
            for side in (False, True)
        )
        split = create_split(
            registry,
            task=task,
            release=release,
            rule="custom",
            train=train,
            test=test,
            test_preferences=parse_names(test_preferences),
            default=default,
        )
        print(f"{split.id}: {len(train)} train, {len(test)} test")


if __name__ == "__main__":
    sys.exit(run())
