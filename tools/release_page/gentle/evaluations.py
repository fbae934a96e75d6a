"""Condense an evaluation on a gentle task: a row is a robot, a partner and a preference.

Of a series it is also a place. It has the mean return, the shares of episodes, and their number.
"""

import re
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

import polars as pl

from evaluation.record import tables
from evaluation.record.columns import PARTNER_COLUMNS, validate_episodes, with_safety
from tools.release_page.data import EGOS
from tools.release_page.folders import EGO_FILE, how_it_ran, small

SERIES = "-series"  # ends the name of a method that played series of episodes
REFERENCES = {"script": "script", "random": "uniform-random"}  # methods, as references are called
KEY = ("ego_seed", "partner", "preference")  # of a row; of series, `place` too
MEASURES = ("return", "success", "safe_success", "violated")  # means over a row's episodes
_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}(-[a-z0-9_]{1,32}){0,9}")
_TOLD = ("task", "release", "split", "env_version", "backend", "engine", "lock")
_RUN = ("command", "date", "devices", "versions", "env_steps", "seconds")


def checked_name(name: object, what: str) -> str:
    """Return a method's or split's name, which names a folder.

    Raises:
        ValueError: It is no short name of lowercase words with hyphens between them.
    """
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise ValueError(f"the {what} is {name!r}; expected a name such as ppo-gru or half-s0-v2")
    return name


def place_of(data: Path, task: str, split: object, method: str) -> Path:
    """Return the folder of a method with a split, whose id may begin with the task."""
    name = split.removeprefix(f"{task}/") if isinstance(split, str) else split
    return data / EGOS / task / checked_name(name, "split") / method


def collect_evaluation(
    folder: Path, summary: Mapping[str, Any], data: Path, method: str | None
) -> Path:
    """Condense a finished evaluation; return the folder that was written.

    Args:
        folder: Of evaluate.
        summary: Of the folder, its task checked.
        data: Of the release.
        method: Name of the robots' method; without it, their files' ("ppo-s0" is of ppo).
            "script" and "random" are an evaluation's references, where it played them.

    Raises:
        ValueError: The folder has one side of the split alone, or names no split of ours.
    """
    reference = REFERENCES.get(method or "")
    table = _reference_episodes(folder, reference) if reference else None
    file = tables.EPISODES_FILE if table is None else tables.REFERENCES_FILE
    table = tables.read_episodes(folder / file) if table is None else table
    if lacking := [name for name in ("preference", "violated") if name not in table.columns]:
        raise ValueError(f"{folder} lacks {', '.join(lacking)}, which every gentle task tells")
    series = "place" in table.columns
    sides = {"test"} if series else {"train", "test"}
    if missing := sides - set(table["side"]):
        raise ValueError(
            f"{folder} has no {' and no '.join(sorted(missing))} partners; run evaluate with "
            "--split both"
        )
    name, seeds = _seeds(table["ego"].unique().sort().to_list(), method, folder)
    name += SERIES if series and not name.endswith(SERIES) else ""
    split = summary.get("split")
    split = split.get("id") if isinstance(split, dict) else split
    out = place_of(data, summary["task"], split, name)
    pairs = condense(table.with_columns(ego_seed=pl.col("ego").replace_strict(seeds)))
    steps = int(table["steps"].sum())
    run = how_it_ran(folder, summary, steps)
    content = {
        **{field: summary.get(field) for field in _TOLD},
        "egos": len(seeds),
        "episodes": table.height,
        "episodes_per_pair": table.height // table.select("ego", "partner").n_unique(),
        "nonfinite": int(table["nonfinite"].sum()),
    }
    tables.write_parquet(pairs, out / tables.PAIRS_FILE)
    tables.write_json(content, out / tables.SUMMARY_FILE)
    tables.write_json({field: run[field] for field in _RUN if field in run}, out / tables.RUN_FILE)
    return out


def condense(table: pl.DataFrame) -> pl.DataFrame:
    """Condense episodes, their robots in `ego_seed`, to a row a robot, partner and preference.

    A series keeps the place as well. Means are floats and counts integers of 32 bits.
    """
    key = [*KEY, *(["place"] if "place" in table.columns else [])]
    partners = [name for name in PARTNER_COLUMNS if name not in key]
    return small(
        with_safety(table)
        .group_by(key)
        .agg(
            *(pl.col(name).first() for name in partners),
            *(pl.col(name).cast(pl.Float64).mean() for name in MEASURES),
            pl.len().alias("episodes"),
            pl.col("nonfinite").sum(),
        )
        .sort(key)
    )


def _reference_episodes(folder: Path, reference: str) -> pl.DataFrame | None:
    """Return the episodes of one of an evaluation's references; None where it played none."""
    path = folder / tables.REFERENCES_FILE
    if not path.is_file():
        return None
    table = tables.read_parquet(path)
    if "reference" not in table.columns:
        raise ValueError(f"{path} has no column reference; take a finished folder of evaluate")
    # Beside a passive human, who is no partner, a reference plays on no side.
    table = table.filter(pl.col("reference") == reference, pl.col("side").is_not_null())
    return None if table.is_empty() else validate_episodes(table.drop("reference"))


def _seeds(egos: list[str], method: str | None, folder: Path) -> tuple[str, dict[str, int]]:
    """Return the method's name and each robot's seed: its file's, or else its place."""
    matches = [EGO_FILE.fullmatch(PurePath(ego).name) for ego in egos]
    methods = {match["method"] for match in matches if match}
    if method is None and (None in matches or len(methods) != 1):
        raise ValueError(
            f"{folder} evaluated {', '.join(egos[:3])}; name their method with --as, such as "
            "--as ppo-gru"
        )
    name = checked_name(method or methods.pop(), "method")
    seeds = [int(match["seed"]) for match in matches if match]
    if len(set(seeds)) < len(egos):
        seeds = list(range(len(egos)))
    return name, dict(zip(egos, seeds, strict=True))
