"""A figure with its command: the forces that the partners of an evaluation felt."""

from pathlib import Path

from assistax_zoo.commands.options import Page


def forces(folder: Path, /, *, out: Path, page: Page = Page()) -> None:
    """Draw how hard each partner of an evaluation was pressed, against its return.

    Args:
        folder: Folder that `assistax-zoo evaluate --out` filled.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot forces results --out forces.pdf
    """
    from evaluation.plots.style import INK, check_path, own_style, save_figure, titled_figure
    from evaluation.record import tables
    from evaluation.record.verification import check_whole

    check_path(out)
    check_whole(folder)
    partners = tables.read_parquet(folder / tables.PARTNERS_FILE)
    width, height = page.width or 6.0, 4.0
    with own_style():
        caption = f"{partners.height} partners, means over robots and episodes."
        figure = titled_figure("Force and return", caption, width, height)
        axes = figure.add_axes((0.9 / width, 0.22, 1 - 1.2 / width, 0.6))
        axes.scatter(partners["force_peak"], partners["return"], color=INK, s=16)
        axes.set(xlabel="peak force, N", ylabel="return of an episode")
    save_figure(figure, out, bare=page.bare)
    print(out)
