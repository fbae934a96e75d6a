"""The results of a release: condensed tables, and the page made from them.

Run from a checkout: `python -m tools.release_page collect` and `page`.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

from cyclopts import App
from cyclopts.exceptions import CycloptsError

PROGRAM = "python -m tools.release_page"
DPI = 130  # a 198 x 198 matrix keeps more than three points a cell


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0 when done, 1 after an error, 2 after wrong usage.

    Args:
        arguments: Words of the command line; this process's own if None.
    """
    app = App(name=PROGRAM, help=__doc__)
    for command in (collect, page):
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
    """Write the page of a release's results beside the paper's, with its figures.

    Results that are not measured yet are named in the page, and counted on standard error.

    Args:
        release: Release, such as v1.
        data: Folder of the release's tables, which `collect` fills.
        out: Page to write, .md.
        images: Folder for the figures; default images/RELEASE beside the page.
        check: Write nothing; fail if the page is out of date, or lacks a figure.
        registry: Registry to read instead of the installed one.

    Example:
        python -m tools.release_page page --release v1 --data docs/data/paper --out v1.md
    """
    from tools.release_page import paper
    from tools.release_page.pages import check_pages, relative_folder, relinked
    from zoo.registry import load_registry

    if out.suffix.lower() != ".md":
        raise ValueError(
            f"{out.name} ends in {out.suffix or 'nothing'!r}; the page is written as .md"
        )
    folder = images or out.parent / "images" / release
    published = load_registry(registry)
    results = paper.read_results(published, release, data)
    notes = {key: relinked(note, data, out) for key, note in results.notes.items()}
    results = dataclasses.replace(results, notes=notes)
    places = f"--data {data.as_posix()} --out {out.as_posix()}"
    if images:
        places += f" --images {images.as_posix()}"
    command = f"{PROGRAM} page --release {release} {places}"
    text = paper.make_page(results, relative_folder(folder, out), command)
    figures = paper.figures(results)
    files = {out: text} | {
        out.parent / release / name: table for name, table in paper.tables(results).items()
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


def collect(folders: tuple[Path, ...], /, *, out: Path) -> None:
    """Condense folders of crossplay, evaluate --split both and train-ego into a release's tables.

    A row an episode becomes a row a pair; no path of a machine is kept. The tasks are the paper's.

    Args:
        folders: Finished folders; each is recognised by what it holds.
        out: Folder of the release's tables.

    Example:
        python -m tools.release_page collect runs/eval-ppo runs/ego-ppo --out docs/data/paper
    """
    from tools.release_page.collect import collect as condense

    if not folders:
        raise ValueError(
            "no folder given; name at least one of crossplay, evaluate --split both or train-ego"
        )
    for folder in folders:
        written = condense(folder, out)
        size = sum(path.stat().st_size for path in written.iterdir())
        print(f"{folder} -> {written}, {size / 1e6:.2f} MB")


if __name__ == "__main__":
    sys.exit(run())
