"""The page's sections about a cross-play."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation import tables
from evaluation.plots.heatmap import crossplay_heatmap
from evaluation.plots.matrix import arrange, short_names
from evaluation.report import html
from evaluation.report.matrix_data import matrix_data

_INTRODUCTION = """<h2>Every robot with every human</h2>
<p>Point at a cell for the pair, click to hold it. Drag to move; zoom with the buttons, with +
and -, or with the wheel once the matrix was clicked. Dots and bold figures are self-play.</p>"""
_VIEWER = html.Html("""<div class="controls">
<label>order <select id="order"></select></label>
<label>colour <select id="measure"></select></label>
<label>find <input id="find" type="search" placeholder="part of an id" size="14"></label>
<span><button id="in" title="zoom in (+)" aria-label="zoom in">+</button>
<button id="out" title="zoom out (-)" aria-label="zoom out">-</button>
<button id="all" title="whole matrix (0)">all</button></span>
<span class="scale"><span id="low"></span><i id="ramp"></i><span id="high"></span></span>
</div>
<div class="viewer"><canvas id="matrix" tabindex="0" role="img" aria-label="cross-play matrix;
the tables below and the static figure hold the same values"></canvas>
<div id="tip" hidden></div></div>""")


def crossplay_sections(folder: Path, summary: Mapping[str, Any]) -> list[html.Html]:
    """Return headline, matrix, tables, strategies and the static figure."""
    pairs, order = (
        tables.read_parquet(folder / tables.PAIRS_FILE),
        tables.read_json(folder / tables.ORDER_FILE),
    )
    path = folder / tables.STRATEGIES_FILE
    strategies = tables.read_json(path) if path.is_file() else None
    data = matrix_data(pairs, order, strategies)
    static = html.image(
        crossplay_heatmap(arrange(pairs, order), summary), "clustered cross-play matrix", "png"
    )
    return [
        _tiles(summary),
        html.notes(summary["notes"]),
        html.Html(_INTRODUCTION),
        _VIEWER,
        _key(data),
        html.embedded("matrix-data", data),
        html.Html(
            "<noscript><p>The matrix needs JavaScript; the static figure below does "
            "not.</p></noscript>"
            "<h2>Self-play and cross-play</h2>"
        ),
        html.figures_table(_figures(summary), "return of an episode"),
        _best(summary),
        *(_strategies(strategies) if strategies else []),
        html.fill("<h2>Static figure</h2>{}", static),
    ]


def _tiles(summary: Mapping[str, Any]) -> html.Html:
    tiles = []
    for name, key in (("self-play", "self_play"), ("cross-play", "cross_play"), ("gap", "gap")):
        if figure := summary[key]:
            ends = f"95% {html.interval(figure, 0)}, IQM" if figure["iqm_ci"] else "IQM"
            tiles.append(html.tile(f"{figure['iqm']:.0f}", name, ends))
    if relative := summary["relative_gap"]:
        tiles.append(
            html.tile(f"{relative['value']:.1%}", "relative gap of the means", "(SP - XP) / SP")
        )
    best = summary["best_ego"]
    tiles.append(html.tile(f"{best['mean']:.0f}", "best robot, mean return", best["ego"]))
    return html.tiles(tiles)


def _key(data: Mapping[str, Any]) -> html.Html:
    parts = []
    for trait in ("disability", "algorithm"):
        parts.append(html.fill("<b>{}</b>", trait))
        parts += [
            html.swatch(colour, name + _meaning(name))
            for name, colour in data["palettes"][trait].items()
        ]
    return html.fill('<div class="key">{}</div>', html.join(parts))


def _meaning(name: str) -> str:
    setting = DISABILITY_SETTINGS.get(name)
    return f": range {setting.elbow_range:g}, strength {setting.strength:g}" if setting else ""


def _figures(summary: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "self-play": summary["self_play"],
        "cross-play": summary["cross_play"],
        "self-play - cross-play": summary["gap"],
        "cross-play within one algorithm": summary["within_algorithm"],
        "cross-play across algorithms": summary["across_algorithms"],
        "cross-play within one disability setting": summary["within_disability"],
        "cross-play across disability settings": summary["across_disabilities"],
    }


def _best(summary: Mapping[str, Any]) -> html.Html:
    stability = summary["rank_stability"]
    if not stability:
        return html.Html("")
    text = (
        "Ranking of the robots on random halves of the humans: Kendall's τ "
        f"{stability['tau']:.2f}, between {stability['spread'][0]:.2f} and "
        f"{stability['spread'][1]:.2f} in 95% of {stability['halvings']} halvings."
    )
    return html.fill("<p>{}</p>", text)


def _strategies(found: Mapping[str, Any]) -> list[html.Html]:
    names = [one["partner"] for one in found["partners"]]
    short = dict(zip(names, short_names(names), strict=True))
    headings = [("cluster", ""), ("medoid", ""), ("humans", "")]
    headings += [(name.replace("_", " "), unit) for name, unit in found["features"].items()]
    rows: list[list[html.Cell]] = [
        [
            chr(ord("A") + i),
            short[cluster["medoid"]],
            len(cluster["members"]),
            *cluster["mean"].values(),
        ]
        for i, cluster in enumerate(found["clusters"])
    ]
    robots = short_names([one["robot"] for one in found["partners"]])
    each: list[list[html.Cell]] = [
        [
            short[one["partner"]],
            robot,
            chr(ord("A") + one["cluster"]),
            *(one[name] for name in found["features"]),
        ]
        for robot, one in zip(robots, found["partners"], strict=True)
    ]
    silhouette = "" if found["silhouette"] is None else f" (silhouette {found['silhouette']:.2f})"
    clear = "" if len(found["clusters"]) > 1 else " None is clear: all are one."
    diversity = found["br_div"]
    parts = [
        html.Html("<h2>Strategies of the humans</h2>"),
        html.fill(
            "<p>Behaviour with the best robot of this cross-play: average linkage on features "
            "scaled to [0, 1]{}.{} BR-Div: rank {} of {}, participation ratio {}.</p>",
            silhouette,
            clear,
            diversity["rank"],
            diversity["n"],
            f"{diversity['participation_ratio']:.2f}",
        ),
        html.table(headings, rows),
        html.fill(
            "<p>A diverse subset, greedily by log-determinant: {}.</p>",
            ", ".join(found["diverse_subset"]),
        ),
        _incompatible(found["incompatible"]),
        html.Html("<h3>Each human with its best robot</h3>"),
        html.table(
            [("human", ""), ("best robot", ""), ("cluster", ""), *headings[3:]], each, sortable=True
        ),
    ]
    return [part for part in parts if part]


def _incompatible(pair: Mapping[str, Any] | None) -> html.Html:
    if not pair:
        return html.Html("")
    own, exchanged = (
        " and ".join(f"{value:.0f}" for value in pair[key])
        for key in ("returns", "returns_exchanged")
    )
    return html.fill(
        "<p>The most incompatible two: <b>{}</b> and <b>{}</b>. With their best robots they earn "
        "{}, with the robots exchanged {}.</p>",
        *pair["partners"],
        own,
        exchanged,
    )
