"""Assemble the page: what was found, the figures, the tables, and how to repeat it."""

import hashlib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import polars as pl

from evaluation import tables
from evaluation.provenance import read_manifest
from evaluation.report import html
from evaluation.report.crossplay import crossplay_sections
from evaluation.report.evaluation import evaluation_sections
from evaluation.summary import EvaluationSummary, read_summary


def write_report(folder: Path, path: Path) -> None:
    """Write the page about a folder that `evaluate` or `crossplay` filled, complete or not at all.

    Raises:
        FileNotFoundError: The folder, or a table in it, is missing.
        ValueError: The folder holds neither an evaluation nor a cross-play.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(
            f"{path.name} ends in {path.suffix or 'nothing'!r}; a report is written as .html"
        )
    try:
        text = _folder_page(folder)
    except (pl.exceptions.PolarsError, *_STRANGE) as error:
        # A folder that somebody sent: its hashes may be right and its tables no tables of ours.
        reason = (str(error).splitlines() or [""])[0][:200]
        raise ValueError(
            f"{folder} is damaged, or of another version ({type(error).__name__}: {reason!a}); "
            "run again"
        ) from None
    tables.write_bytes(text.encode(), path)


def _folder_page(folder: Path) -> str:
    found = read_summary(folder)
    summary = tables.to_json(found)
    if isinstance(found, EvaluationSummary):
        title, sections = (
            f"Zero-shot evaluation: {found.task}",
            evaluation_sections(folder, summary),
        )
    else:
        title, sections = f"Cross-play: {found.task}", crossplay_sections(folder, summary)
    return _page(title, _head(title, folder, summary), [*sections, _origin(folder, summary)])


# What tables and fields of other kinds than ours lead to.
_STRANGE = (ArithmeticError, AttributeError, LookupError, TypeError)
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
{css}</style>
</head>
<body>
<header>
{head}
</header>
<main>
{body}
</main>
{scripts}
</body>
</html>
"""


def _page(title: str, head: html.Html, sections: list[html.Html]) -> html.Html:
    assets = resources.files("evaluation.report") / "assets"
    css, sorting, matrix = (
        html.Html((assets / name).read_text("utf-8"))
        for name in ("report.css", "tables.js", "matrix.js")
    )
    body = html.join(sections, "\n")
    scripts = [sorting, matrix] if 'id="matrix-data"' in body else [sorting]
    run = html.join(html.fill("<script>{}</script>", script) for script in scripts)
    return html.fill(_PAGE, title=title, css=css, head=head, body=body, scripts=run)


def _head(title: str, folder: Path, summary: Mapping[str, Any]) -> html.Html:
    run = _run(folder)
    facts = [
        f"release {summary['release']}",
        f"environment version {summary['env_version']}",
        f"backend {summary['backend']}",
        f"{summary['episodes']:,} episodes, {summary['episodes_per_pair']} a pair",
        f"{summary['nonfinite']} non-finite",
        *([f"split {summary['split']['id']}"] if summary["split"] else []),
        *([run["date"].partition("T")[0]] if run else []),
    ]
    return html.fill("<h1>{}</h1>\n{}", title, html.chips(facts))


def _origin(folder: Path, summary: Mapping[str, Any]) -> html.Html:
    """Return how the figures came about: command, versions, hashes."""
    run = _run(folder)
    manifest = read_manifest(folder) or {}
    identity = manifest.get("identity", {})
    parts = [html.Html("<h2>How to repeat it</h2>")]
    if run:
        parts.append(html.fill("<pre>{}</pre>", run["command"]))
        where = f"Python {run['python']}, {run['platform']}, {', '.join(run['devices'])}"
        machine = f"{where}; finished {run['date']}"
        parts.append(html.fill('<p class="muted">{}</p>', machine))
        parts.append(
            html.table(
                [("package", ""), ("version", "")], [list(row) for row in run["versions"].items()]
            )
        )
    if identity:
        settings = ("backend", "episodes", "seed", "stochastic", "evaluator_version")
        rows: list[list[html.Cell]] = [
            [name, str(identity[name])] for name in settings if name in identity
        ]
        parts += [
            html.Html("<h3>Settings</h3>"),
            html.table([("setting", ""), ("value", "")], rows),
        ]
    hashes: list[list[html.Cell]] = [
        [name, digest] for name, digest in _hashes(folder, summary, manifest).items()
    ]
    parts += [
        html.Html("<h3>Hashes (sha256)</h3>"),
        html.table([("what", ""), ("sha256", "")], hashes),
    ]
    if identity:
        members: list[list[html.Cell]] = [["robot", row[0], row[1]] for row in identity["egos"]]
        members += [["human", row[0], row[3]] for row in identity["partners"]]
        listed = html.table([("seat", ""), ("policy", ""), ("sha256", "")], members, sortable=True)
        told = "<details><summary>{} policies with their hashes</summary>{}</details>"
        parts.append(html.fill(told, len(members), listed))
    parts.append(
        html.Html(
            "<footer>Made by assistax-zoo from saved tables; this page loads nothing from "
            "elsewhere.</footer>"
        )
    )
    return html.join(parts, "\n")


def _hashes(
    folder: Path, summary: Mapping[str, Any], manifest: Mapping[str, Any]
) -> dict[str, str]:
    hashes = {}
    if summary["split"]:
        hashes[f"split {summary['split']['id']}"] = summary["split"]["sha256"]
    if "job" in manifest:
        hashes["job: policies, settings and software"] = manifest["job"]
    names = (
        tables.EPISODES_FILE,
        tables.PAIRS_FILE,
        tables.REFERENCES_FILE,
        tables.BOUNDS_FILE,
        tables.SUMMARY_FILE,
    )
    for name in names:
        if (folder / name).is_file():
            hashes[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    return hashes


def _run(folder: Path) -> dict[str, Any] | None:
    path = folder / tables.RUN_FILE
    return tables.read_json(path) if path.is_file() else None
