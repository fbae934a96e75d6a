"""The results of a release: condensed tables, and the page that shows them beside the paper's."""

import sys
from pathlib import Path


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
        data: Folder of the release's tables, which `assistax-zoo results collect` fills.
        out: Page to write, .md.
        images: Folder for the figures; default images/RELEASE beside the page.
        check: Write nothing; fail if the page or one of its figures is not what would be written.
        registry: Registry to read instead of the installed one.

    Example:
        assistax-zoo results page --release v1 --data docs/data/v1 --out docs/results.md
    """
    from evaluation.results.data import read_results
    from evaluation.results.page import first_difference, make_page, relative_folder
    from evaluation.results.pictures import picture_names
    from zoo.registry import load_registry

    if out.suffix.lower() != ".md":
        raise ValueError(
            f"{out.name} ends in {out.suffix or 'nothing'!r}; the page is written as .md"
        )
    folder = images or out.parent / "images" / release
    results = read_results(load_registry(registry), release, data)
    command = f"assistax-zoo results page --release {release} --data {data.as_posix()} --out {out.as_posix()}"
    text = make_page(results, relative_folder(folder, out), command)
    again = f"run `{command}`"
    if check:
        if not out.is_file():
            raise ValueError(f"{out} does not exist; {again}")
        if (found := out.read_text(encoding="utf-8")) != text:
            raise ValueError(
                f"{out} is not what the tables give: {first_difference(found, text)}; {again}"
            )
        if missing := [name for name in picture_names(results) if not (folder / name).is_file()]:
            raise ValueError(f"{folder} lacks {', '.join(missing)}; {again}")
    else:
        from evaluation.results.figures import draw_figures
        from evaluation.tables import atomic_path

        draw_figures(results, folder)
        with atomic_path(out) as temporary:
            temporary.write_text(text, encoding="utf-8")
    _warn(results.missing)
    print(f"{out} is what the tables give" if check else out)


def collect(folders: tuple[Path, ...], /, *, out: Path) -> None:
    """Condense finished folders of crossplay, evaluate --split both and train-ego into a release's tables.

    A row an episode becomes a row a pair; egos are named by their files, so that no path of a
    machine is kept.

    Args:
        folders: Finished folders; each is recognised by what it holds.
        out: Folder of the release's tables.

    Example:
        assistax-zoo results collect runs/xp-scratch runs/eval-scratch-ppo runs/scratch-ppo --out
        docs/data/v1
    """
    from evaluation.results.collect import collect as condense

    if not folders:
        raise ValueError(
            "no folder given; name at least one of crossplay, evaluate --split both or train-ego"
        )
    for folder in folders:
        written = condense(folder, out)
        size = sum(path.stat().st_size for path in written.iterdir())
        print(f"{folder} -> {written}, {size / 1e6:.2f} MB")


def _warn(missing: list[str]) -> None:
    for what in missing:
        print(f"warning: not measured yet: {what}", file=sys.stderr)
    if missing:
        print(f"{len(missing)} warnings", file=sys.stderr)
