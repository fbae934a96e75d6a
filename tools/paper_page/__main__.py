"""The results of a release: condensed tables, and the page that shows them beside the paper's.

Run from a checkout: `python -m tools.paper_page page` and `python -m tools.paper_page collect`.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from cyclopts import App
from cyclopts.exceptions import CycloptsError

PROGRAM = "python -m tools.paper_page"


def run(arguments: Sequence[str] | None = None) -> int:
    """Run `page` or `collect`; see `run_commands`."""
    return run_commands(PROGRAM, __doc__, (page, collect), arguments)


def run_commands(
    program: str,
    about: str | None,
    commands: Sequence[Callable[..., None]],
    arguments: Sequence[str] | None,
) -> int:
    """Run one of a program's commands; return 0 when done, 1 after an error, 2 after wrong usage.

    Args:
        program: As it is called.
        about: What its help says first.
        commands: Named as the functions are.
        arguments: Words of the command line; this process's own if None.
    """
    app = App(name=program, help=about)
    for command in commands:
        app.command(command)
    words = sys.argv[1:] if arguments is None else arguments
    try:
        app(words, print_error=False, exit_on_error=False, result_action="return_value")
    except CycloptsError as error:
        print(f"error: {error}\ntry: {program} --help", file=sys.stderr)
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
    """Write the page of a release's results beside the paper's, with its figures.

    Whatever is not measured yet is named in the page, and counted on standard error.

    Args:
        release: Release, such as v1.
        data: Folder of the release's tables, which `collect` fills.
        out: Page to write, .md.
        images: Folder for the figures; default images/RELEASE beside the page.
        check: Write nothing; fail if the page or one of its figures is not what would be written.
        registry: Registry to read instead of the installed one.

    Example:
        python -m tools.paper_page page --release v1 --data docs/data/v1 --out docs/results.md
    """
    from tools.paper_page.data import read_results
    from tools.paper_page.page import check_page, make_page, relative_folder
    from tools.paper_page.pictures import picture_names
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
    again = f"run `{command}`"
    if check:
        check_page(out, text, folder, picture_names(results), again)
    else:
        from evaluation.record.tables import write_bytes
        from tools.paper_page.figures import draw_figures

        draw_figures(results, folder)
        write_bytes(text.encode(), out)
    warn(results.missing)
    print(f"{out} is what the tables give" if check else out)


def collect(folders: tuple[Path, ...], /, *, out: Path) -> None:
    """Condense folders of crossplay, evaluate --split both and train-ego into a release's tables.

    A row an episode becomes a row a pair; egos are named by their files, so that no path of a
    machine is kept.

    Args:
        folders: Finished folders; each is recognised by what it holds.
        out: Folder of the release's tables.

    Example:
        python -m tools.paper_page collect runs/xp-scratch runs/eval-scratch-ppo runs/scratch-ppo
        --out docs/data/v1
    """
    from tools.paper_page.collect import collect as condense

    if not folders:
        raise ValueError(
            "no folder given; name at least one of crossplay, evaluate --split both or train-ego"
        )
    for folder in folders:
        written = condense(folder, out)
        size = sum(path.stat().st_size for path in written.iterdir())
        print(f"{folder} -> {written}, {size / 1e6:.2f} MB")


def warn(missing: list[str]) -> None:
    """Say on standard error what is not measured yet."""
    for what in missing:
        print(f"warning: not measured yet: {what}", file=sys.stderr)
    if missing:
        print(f"{len(missing)} warnings", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(run())
