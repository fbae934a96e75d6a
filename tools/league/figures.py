"""Figures of the league's page: learning curves, and failures by row and partner."""

from collections.abc import Mapping

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from evaluation.figures.bootstrap import curve_band
from evaluation.figures.league import ordered
from evaluation.plots import style
from evaluation.plots.league import panels_of

FAILED = 0.25  # of the best row's return with a partner: below it a row fails with the partner


@style.own_style()
def validation_curves(curves: Mapping[str, Mapping[str, pl.DataFrame]]) -> Figure:
    """Draw the IQM over seeds with the validation side against steps, and its 95% band.

    Args:
        curves: By task and row: columns `seed`, `steps`, `return`, as `evaluation.validation`
            writes them.
    """
    caption = "IQM over seeds; band: pointwise 95% bootstrap."
    figure, panels = panels_of("Validation", caption, curves, 3.4, left=0.75, right=1.5)
    names = ordered({name for rows in curves.values() for name in rows})
    colours = style.algorithm_colours(names)
    looks = [mark + dash for dash in style.DASHES for mark in style.MARKERS]
    drawn = {}
    for rect, (task, rows) in zip(panels, curves.items(), strict=True):
        axes = figure.add_axes(rect)
        for name in ordered(rows):
            wide = rows[name].pivot("seed", index="steps", values="return").sort("steps")
            values = wide.drop("steps").to_numpy().T
            steps, band, colour = wide["steps"].to_numpy() / 1e6, curve_band(values), colours[name]
            centre = band[0] if band else values.mean(axis=0)
            look = looks[names.index(name) % len(looks)]
            (drawn[name],) = axes.plot(steps, centre, look, color=colour, markersize=4)
            if band:
                axes.fill_between(steps, band[1], band[2], color=colour, alpha=0.15, linewidth=0)
        axes.set_xlabel(f"{task}: million environment steps of a robot", fontsize=8)
        axes.set_ylabel("return with validation partners", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(color=style.GRID, linewidth=0.6)
    # One for all, beside them: in a panel it would lie on its curves.
    (width, _), (_, bottom, _, tall) = figure.get_size_inches(), panels[0]
    place = {"bbox_to_anchor": (1 - 1.4 / width, bottom + tall), "loc": "upper left"}
    figure.legend([drawn[name] for name in names], names, fontsize=8, frameon=False, **place)
    return figure


def failures(by_partner: pl.DataFrame) -> pl.DataFrame:
    """Return each row's mean with each partner as a share of the best row's with that partner.

    If no row has a return above 0 with a partner, its share is null.

    Args:
        by_partner: Of `evaluation.figures.league.League`.
    """
    best = by_partner.group_by("partner").agg(pl.col("mean").max().alias("best"))
    joined = by_partner.join(best, on="partner", how="left", maintain_order="left")
    share = pl.when(pl.col("best") > 0).then(pl.col("mean") / pl.col("best"))
    return joined.with_columns(share.alias("share"), (share < FAILED).alias("fails"))


@style.own_style()
def failure_chart(shares: Mapping[str, pl.DataFrame]) -> Figure:
    """Draw the failures of rows by partner, the partner of the lowest mean share on the left.

    Args:
        shares: By task, of `failures`.
    """
    most = max(table["row"].n_unique() for table in shares.values())
    caption = "Share of the best row's return with the same partner; white: not played."
    each, title = 0.8 + 0.26 * most, "Who fails with whom"
    figure, panels = panels_of(title, caption, shares, each, left=0.26 * 6.4, right=0.6)
    image = None
    for rect, (task, table) in zip(panels, shares.items(), strict=True):
        rows = ordered(table["row"].unique().to_list())
        order = table.group_by("partner").agg(pl.col("share").mean()).sort("share", "partner")
        wide = table.pivot("partner", index="row", values="share")
        wide = wide.with_columns(pl.col("row").cast(pl.Enum(rows))).sort("row")
        matrix = wide.select(order["partner"].to_list()).cast(pl.Float64).to_numpy()
        axes = figure.add_axes(rect)
        drawn = np.ma.masked_invalid(np.clip(matrix, 0.0, 1.0))
        image = axes.imshow(
            drawn, aspect="auto", vmin=0, vmax=1, cmap="viridis", interpolation="nearest"
        )
        axes.set_yticks(range(len(rows)), rows, fontsize=8)
        axes.set_xticks([])
        axes.set_xlabel(f"{task}: {matrix.shape[1]} partners, hardest first", fontsize=9)
    assert image is not None
    (width, _), top = figure.get_size_inches(), panels[0]
    place = 1 - 0.5 / width, top[1], 0.13 / width, top[3]
    figure.colorbar(image, cax=figure.add_axes(place)).ax.tick_params(labelsize=7)
    return figure
