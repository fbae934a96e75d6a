"""One page about a finished folder: its results, figures and tables, and how to repeat them.

The texts are in `templates/`. All values are escaped there, so an id with tags is shown as text and
never run.
"""

import base64
import functools
import shlex
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import polars as pl
from markupsafe import Markup
from matplotlib.figure import Figure

from assistax_base.errors import listing
from evaluation.figures.by_parameter import summarise_parameters
from evaluation.figures.contrasts import ContrastFigures
from evaluation.figures.league import (
    columns_of,
    groups_of_table,
    league_table,
    read_league,
    row_folders,
)
from evaluation.figures.normalised import REFERENCE_ORDER
from evaluation.figures.summary import EvaluationSummary, read_summary
from evaluation.plots.captions import provenance
from evaluation.plots.charts import performance_profile, trait_points, zsc_dots
from evaluation.plots.crossplay.heatmap import crossplay_heatmap
from evaluation.plots.crossplay.matrix import arrange, short_names
from evaluation.plots.figures import adaptation_of
from evaluation.plots.league import league_chart
from evaluation.plots.persons import described_panels
from evaluation.plots.style import figure_bytes
from evaluation.record import tables
from evaluation.record.columns import SIDES, TOUCHES
from evaluation.record.manifest import file_sha256, read_manifest
from evaluation.record.record import Record
from evaluation.record.verification import strange_tables_refused, unchecked
from evaluation.report.matrix_data import matrix_data
from zoo.partners.kinds import described_kind, kind_of
from zoo.partners.person_ids import OWN

_HASHED = (
    *(tables.EPISODES_FILE, tables.PAIRS_FILE, tables.REFERENCES_FILE),
    *(tables.BOUNDS_FILE, tables.SUMMARY_FILE),
)


def write_report(
    folder: Path,
    path: Path,
    episodes: Sequence[bytes] = (),
    *,
    contrasts: ContrastFigures | None = None,
) -> None:
    """Write the page about a folder of `evaluate` or `crossplay`, atomically.

    A folder with folders of `evaluate` is a league, and these are its rows.

    Args:
        folder: The folder to report.
        path: The page, .html.
        episodes: Episodes to play on the page, of `evaluation.player.page.pack`; not for a league.
        contrasts: Contrasts of the league's methods.

    Raises:
        FileNotFoundError: The folder, or a table in it, is missing.
        ValueError: The folder has no evaluation, cross-play or league.
    """
    league = bool(row_folders(folder))
    if contrasts is not None and not league:
        raise ValueError(f"{folder} is no folder of rows, which contrasts are of; leave them out")
    if path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(
            f"{path.name} ends in {path.suffix or 'nothing'!r}; a report is written as .html"
        )
    with strange_tables_refused(folder, jinja2.UndefinedError):
        text = _league_page(folder, contrasts) if league else _page(folder, episodes)
    tables.write_bytes(text.encode("utf-8", "replace"), path)  # a folder may be called otherwise


def figures_html(
    figures: Mapping[str, Mapping[str, Any] | None],
    what: str,
    notes: Iterable[str],
    picture: Path,
) -> str:
    """Return estimates as an HTML table, with their notes and a picture, a .png file."""
    template = templates().get_template("figures.html")
    source = f"data:image/png;base64,{base64.b64encode(picture.read_bytes()).decode()}"
    shown = list(figures.items())
    return template.render(figures=shown, what=what, notes=list(notes), picture=source)


@functools.cache
def templates() -> jinja2.Environment:
    """Return the page's templates, which escape all values."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("evaluation.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
    )
    # In the order of their making, which the viewer's menus have.
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    environment.filters["listing"] = listing
    assets = resources.files("evaluation.report") / "assets"
    known: dict[str, Any] = {
        "asset": lambda name: Markup((assets / name).read_text("utf-8")),
        "letter": lambda number: chr(ord("A") + number),
        "touches": TOUCHES,
        "reference_order": REFERENCE_ORDER,
    }
    environment.globals.update(known)
    return environment


def _page(folder: Path, episodes: Sequence[bytes]) -> str:
    figures, manifest = read_summary(folder), read_manifest(folder) or {}
    kind = "evaluation" if isinstance(figures, EvaluationSummary) else "crossplay"
    summary = tables.to_json(figures)
    summary["notes"] = [*summary["notes"], *unchecked(folder)]
    hashes = {}
    if figures.split:
        hashes[f"split {figures.split.id}"] = figures.split.sha256
    if "job" in manifest:
        hashes["job: policies, settings and software"] = manifest["job"]
    hashed = [name for name in _HASHED if (folder / name).is_file()]
    return (
        templates()
        .get_template(f"{kind}.html")
        .render(
            summary=summary,
            run=_read(folder, tables.RUN_FILE),
            identity=manifest.get("identity"),
            episodes=[base64.b64encode(episode).decode() for episode in episodes],
            hashes=hashes | {name: file_sha256(folder / name) for name in hashed},
            **{"evaluation": _evaluation, "crossplay": _crossplay}[kind](folder, summary),
        )
    )


def _league_page(folder: Path, contrasts: ContrastFigures | None) -> str:
    """Return the page about a league's rows."""
    league = read_league(folder)
    table = league_table(league)
    notes = dict.fromkeys((*league.notes, *(contrasts.notes if contrasts else ())))
    counts = ("side", "episodes", "episodes_per_pair", "nonfinite")
    files = {
        f"{name}/{file}": file_sha256(place / file)
        for name, place in row_folders(folder).items()
        for file in (tables.EPISODES_FILE, tables.SUMMARY_FILE)
    }
    hashes = {f"contrasts {contrasts.file}": contrasts.sha256} if contrasts else {}
    return (
        templates()
        .get_template("league.html")
        .render(
            summary={**vars(league.context), **{name: getattr(league, name) for name in counts}},
            notes=[*notes],
            image=_embedded(league_chart({league.context.task: table})),
            rows=table.rows(named=True),
            groups={group: columns_of(group)[0] for group in groups_of_table(table)},
            wishes=list(dict.fromkeys(wish for row in league.rows for wish in row.care.adaptation)),
            contrasts=contrasts,
            episodes=(),
            run=None,
            identity=None,
            hashes=hashes | files,
        )
    )


def _evaluation(folder: Path, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of an evaluation, and the table of its partners."""
    name = folder.resolve().name
    named, profile = {name: summary}, tables.read_parquet(folder / tables.PROFILE_FILE)
    caption = f"Band: pointwise 95% bootstrap.\n{provenance(named)}"
    drawn = performance_profile({name: profile}, task=summary["task"], caption=caption)
    partners = tables.read_parquet(folder / tables.PARTNERS_FILE)
    names = partners["partner"].to_list()
    persons = kind_of(names).has_numbers
    shown_of = _NAMES | (_FAMILY if persons else _SETTING) | _MEASURED
    known = {key: column for key, column in shown_of.items() if column in partners.columns}
    headings, columns = [*known], [*known.values()]
    images = {}
    if any(summary[f"m_{side}"] for side in SIDES):
        images["returns with training and test partners"] = zsc_dots(named)
    if summary["by_group"]:
        images["returns by the partner's group"] = trait_points(named, "group")
    if not persons:
        images["returns by the partner's disability setting"] = trait_points(named)
    if any(map(described_kind().owns, names)):
        images |= _effects_figure(folder)
    images["performance profile"] = drawn
    if summary["by_preference"]:
        images["returns by the human's preference"] = trait_points(named, "preference")
    if summary["adaptation"]:
        images["done beside liked"] = adaptation_of(folder)
    if (folder / tables.BOUNDS_FILE).is_file():
        bounds = tables.read_parquet(folder / tables.BOUNDS_FILE)
        partners = partners.join(
            bounds, on="partner", how="left", maintain_order="left"
        ).with_columns(regret=pl.col("best") - pl.col("return"))
        headings, columns = [*headings, *_BOUNDS], [*columns, *_BOUNDS.values()]
    shown = partners.with_columns(pl.Series("partner", short_names(list(partners["partner"]))))
    return {
        "persons": persons,
        "images": {alt: _embedded(figure) for alt, figure in images.items()},
        "headings": headings,
        "rows": shown.select(columns).sort("return").rows(),
    }


def _effects_figure(folder: Path) -> dict[str, Figure]:
    """Return the figure of the effects of persons' numbers, by title; empty if it has no data.

    Persons may be too few, or their numbers a season's secret.
    """
    try:
        summary = summarise_parameters(Record.read(folder))
    except ValueError:
        return {}
    return {"which numbers of persons matter": described_panels(summary)}


# Heading and unit -> column; some of gentle tasks alone.
_NAMES = {("partner", ""): "partner", ("side", ""): "side"}
_FAMILY, _SETTING = (
    {("family", ""): "partner_algorithm"},
    {("disability", ""): "partner_disability"},
)
_MEASURED = {
    ("mean return", ""): "return",
    ("success", "of episodes"): "success",
    ("discomfort", "of felt steps"): "discomfort_share",
    ("violations", "of episodes"): "violated",
    ("force mean", "N"): "force_mean",
    ("force peak", "N"): "force_peak",
    ("contact peak", "N"): "contact_peak",
    ("sum at once", "N"): "together_peak",
    ("sustained", "N"): "sustained_force",
}
_BOUNDS = {
    ("regret", ""): "regret",
    ("zero action", "L"): "low",
    ("best response", "B"): "best",
    ("source of B", ""): "source",
}


def _crossplay(folder: Path, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the matrix, the viewer's data and the strategies of a cross-play."""
    pairs = tables.read_parquet(folder / tables.PAIRS_FILE)
    strategies = _read(folder, tables.STRATEGIES_FILE)
    listed = strategies["partners"] if strategies else ()
    return {
        "data": matrix_data(pairs, strategies) | {"film": film_of(folder)},
        "strategies": strategies,
        "short": _short([row["partner"] for row in listed])
        | _short([row["robot"] for row in listed]),
        "static": _embedded(crossplay_heatmap(arrange(pairs), summary), "png"),
    }


def film_of(folder: Path) -> dict[str, Any] | None:
    """Return the command that films the first episode of a pair, and the humans' preferences.

    If the manifest does not name the episodes, or all humans had the same starts, return None: such
    episodes cannot be filmed.
    """
    identity = (read_manifest(folder) or {}).get("identity")
    if not identity or not identity.get("apart"):
        return None
    preferences = first_preferences(folder) if "preferences" in identity else {}
    words = ["render", "--task", str(identity["task"]), "--seed", str(int(identity["seed"]))]
    return {"command": shlex.join(["assistax-zoo", *words]), "preferences": preferences}


def first_preferences(folder: Path) -> dict[str, str]:
    """Return the preference of each human of a gentle task in its first episode, by id.

    Humans that bring their own are left out.
    """
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    first = table.filter(pl.col("episode") == 0, pl.col("preference") != OWN)
    return dict(first.select("partner", "preference").unique().sort("partner").rows())


def _short(names: Sequence[str]) -> dict[str, str]:
    return dict(zip(names, short_names(names), strict=True))


def _embedded(figure: Figure, kind: str = "svg") -> str:
    """Return a figure as a data URL."""
    data = base64.b64encode(figure_bytes(figure, f".{kind}", dpi=150)).decode()
    return f"data:image/{'svg+xml' if kind == 'svg' else kind};base64,{data}"


def _read(folder: Path, name: str) -> dict[str, Any] | None:
    path = folder / name
    return tables.read_json(path) if path.is_file() else None
