"""The page's sections about the evaluation of a robot."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from evaluation import tables
from evaluation.plots.bars import disability_points, provenance, zsc_bars
from evaluation.plots.lines import performance_profile
from evaluation.plots.matrix import short_names
from evaluation.report import html

_MEASURES = (("success", "of episodes"), ("force_mean", "N"), ("force_peak", "N"))


def evaluation_sections(folder: Path, summary: Mapping[str, Any]) -> list[html.Html]:
    """Return headline, figures, tables and partners."""
    name = folder.resolve().name
    partners = tables.read_parquet(folder / tables.PARTNERS_FILE)
    return [
        _tiles(summary),
        html.notes(summary["notes"]),
        _policies(summary),
        html.Html("<h2>Return with partners it never met</h2>"),
        html.figures_table(_figures(summary), "return of an episode"),
        *(_references(summary) if summary.get("references") else []),
        html.fill("<h2>Figures</h2>{}", _drawn(folder, name, summary)),
        html.Html("<h2>Each partner</h2>"),
        html.Html("<p>Means over robots and episodes. A click on a heading sorts.</p>"),
        _partners(folder, partners),
    ]


def _tiles(summary: Mapping[str, Any]) -> html.Html:
    tiles = []
    for name, key in (
        ("M_test, IQM", "m_test"),
        ("M_train, IQM", "m_train"),
        ("M_train - M_test, IQM", "gap"),
    ):
        if figure := summary[key]:
            ends = f"95% {html.interval(figure, 0)}" if figure["iqm_ci"] else ""
            tiles.append(html.tile(f"{figure['iqm']:.0f}", name, ends))
    relative = summary.get("relative")
    if relative and (figure := relative["br_prox"]):
        tiles.append(
            html.tile(f"{figure['iqm']:.2f}", "BR-Prox", f"95% {html.interval(figure, 2)}")
        )
    worst = summary["worst_partner"]
    tiles.append(html.tile(f"{worst['mean']:.0f}", "worst partner, mean", worst["partner"]))
    return html.tiles(tiles)


def _policies(summary: Mapping[str, Any]) -> html.Html:
    listed = html.join((html.fill("<code>{}</code>", name) for name in summary["egos"]), ", ")
    what = "Policy" if len(summary["egos"]) == 1 else f"{len(summary['egos'])} seeds of one method"
    return html.fill("<p>{}: {}</p>", what, listed)


def _figures(summary: Mapping[str, Any]) -> dict[str, Any]:
    side = summary["side"]
    figures = {
        "M_test": summary["m_test"],
        "M_train": summary["m_train"],
        "M_train - M_test": summary["gap"],
    }
    for key in ("by_algorithm", "by_disability"):
        figures |= {f"{side} partners of {name}": figure for name, figure in summary[key].items()}
    return figures


def _references(summary: Mapping[str, Any]) -> list[html.Html]:
    relative = summary["relative"]
    own = {"these policies": summary[f"m_{summary['side']}"]}
    compared = {name.replace("_", " "): figure for name, figure in summary["references"].items()}
    shares = {"normalised return": relative["normalised_return"], "BR-Prox": relative["br_prox"]}
    sources = ", ".join(f"{name} for {count}" for name, count in relative["bounds"]["best"].items())
    parts = [
        html.Html("<h2>What that means</h2>"),
        html.fill(
            "<p>Reference egos with the same {} partners and episodes. The best response is the "
            "best robot known with each partner: {} of them; a lower bound of the true one.</p>",
            summary["side"],
            sources,
        ),
        html.figures_table(own | compared, "return of an episode"),
        html.figures_table(shares, "0 is zero action, 1 the best response", digits=2),
    ]
    if relative["coverage"]:
        covered, worst = relative["coverage"], relative["worst_regret"]
        share = covered["value_ci"]
        ends = f", 95% {share[0]:.0%} to {share[1]:.0%}" if share else ""
        parts.append(
            html.fill(
                "<p>Within {} of the best response with {} of partners{}. Mean regret {}, the "
                "largest {} with <code>{}</code>.</p>",
                f"{covered['epsilon']:.0%}",
                f"{covered['value']:.0%}",
                ends,
                f"{relative['regret']['mean']:.1f}",
                f"{worst['regret']:.1f}",
                worst["partner"],
            )
        )
    if relative["unscorable"]:
        named = ", ".join(relative["unscorable"])
        parts.append(html.fill("<p>Unscorable, best response at or below L: {}.</p>", named))
    return parts


def _drawn(folder: Path, name: str, summary: Mapping[str, Any]) -> html.Html:
    named = {name: summary}
    profile = {name: tables.read_parquet(folder / tables.PROFILE_FILE)}
    caption = f"Band: pointwise 95% bootstrap.\n{provenance(named)}"
    drawn = [
        html.image(zsc_bars(named), "returns with training and test partners"),
        html.image(disability_points(named), "returns by the partner's disability setting"),
        html.image(
            performance_profile(profile, task=summary["task"], caption=caption),
            "performance profile",
        ),
    ]
    return html.fill('<div class="figures">{}</div>', html.join(drawn))


def _partners(folder: Path, partners: pl.DataFrame) -> html.Html:
    headings = [("partner", ""), ("side", ""), ("disability", ""), ("mean return", "")]
    headings += [(name.replace("_", " "), unit) for name, unit in _MEASURES]
    columns = ["partner", "side", "partner_disability", "return", *(name for name, _ in _MEASURES)]
    if (folder / tables.BOUNDS_FILE).is_file():
        bounds = tables.read_parquet(folder / tables.BOUNDS_FILE)
        partners = partners.join(
            bounds, on="partner", how="left", maintain_order="left"
        ).with_columns(regret=pl.col("best") - pl.col("return"))
        headings += [
            ("regret", ""),
            ("zero action", "L"),
            ("best response", "B"),
            ("source of B", ""),
        ]
        columns += ["regret", "low", "best", "source"]
    partners = partners.with_columns(
        pl.Series("partner", short_names(partners["partner"].to_list()))
    )
    rows = [list(row) for row in partners.select(columns).sort("return").iter_rows()]
    return html.table(headings, rows, sortable=True)
