"""The results of the release of gentle tasks: condensed tables, and the page made from them.

Run from a checkout: `python -m tools.results_v2 collect`, `cluster` and `page`.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tools.paper_page.__main__ import run_commands, warn

PROGRAM = "python -m tools.results_v2"


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0 when done, 1 after an error, 2 after wrong usage."""
    return run_commands(PROGRAM, __doc__, (collect, cluster, page), arguments)


def collect(
    folders: tuple[Path, ...],
    /,
    *,
    out: Path,
    method: Annotated[str | None, Parameter(name="--as")] = None,
    split: str | None = None,
) -> None:
    """Condense folders of evaluate --split both, train-ego and crossplay into small tables.

    Args:
        folders: Finished folders; each is recognised by what it holds.
        out: Folder of the release's tables.
        method: Name of the method of all these folders, such as ppo-gru, ppo-told, or ppo-mirror of
            egos trained with the test side; without it, the one in the egos' file names. "script"
            and "random" take an evaluation's references.
        split: Split under which a training is filed; without it, the one that was trained with.
            Give it for ppo-mirror, whose own split has the sides exchanged.

    Example:
        python -m tools.results_v2 collect runs/eval-gru runs/ego-gru --as ppo-gru
        --out docs/data/v2
    """
    from tools.results_v2.collect import collect as condense

    if not folders:
        raise ValueError("no folder given; name at least one of evaluate, train-ego or crossplay")
    for folder in folders:
        print(f"{folder} -> {condense(folder, out, method, split)}")


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
        python -m tools.results_v2 cluster gentle_bath --release v2 --data docs/data/v2
    """
    from assistax_zoo.commands.options import parse_names
    from tools.paper_page.collect import CROSSPLAY
    from tools.paper_page.data import read_crossplay
    from tools.results_v2.measures import conventions
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


def page(
    *,
    release: str,
    data: Path,
    out: Path,
    images: Path | None = None,
    check: bool = False,
    registry: Path | None = None,
) -> None:
    """Write the page of a release of gentle tasks, with the pictures of its cross-plays.

    Whatever is not measured yet is named in the page, and counted on standard error. Beside the
    release's diversity stands that of v1, whose tables are looked for beside the release's.

    Args:
        release: Release, such as v2.
        data: Folder of the release's tables, which `collect` fills.
        out: Page to write, .md.
        images: Folder for the figures; default images/RELEASE beside the page.
        check: Write nothing; fail if the page is not what would be written, or lacks a figure.
        registry: Registry to read instead of the installed one.

    Example:
        python -m tools.results_v2 page --release v2 --data docs/data/v2 --out docs/results-v2.md
    """
    from tools.paper_page.page import check_page, relative_folder
    from tools.results_v2.data import read_results
    from tools.results_v2.page import make_page, picture_names
    from zoo.registry import load_registry

    if out.suffix.lower() != ".md":
        raise ValueError(
            f"{out.name} ends in {out.suffix or 'nothing'!r}; the page is written as .md"
        )
    folder = images or out.parent / "images" / release
    results = read_results(load_registry(registry), release, data)
    places = f"--data {data.as_posix()} --out {out.as_posix()}"
    command = f"{PROGRAM} page --release {release} {places}"
    text = make_page(results, relative_folder(folder, out), command)
    if check:
        check_page(out, text, folder, picture_names(results), f"run `{command}`")
    else:
        from evaluation.plots.style import save_figure
        from evaluation.record.tables import write_bytes
        from tools.paper_page.figures import DPI, heatmap

        for name, played in zip(picture_names(results), results.crossplay.values(), strict=True):
            save_figure(heatmap(played), folder / name, DPI)
        write_bytes(text.encode(), out)
    warn(results.missing)
    print(f"{out} is what the tables give" if check else out)


if __name__ == "__main__":
    sys.exit(run())
