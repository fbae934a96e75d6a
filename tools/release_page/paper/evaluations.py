"""Condensed evaluations of the paper's tasks: a row for each pair, egos named by their files."""

from pathlib import Path, PurePath
from typing import Any

import polars as pl

from evaluation.figures.saved_tables import pair_table
from evaluation.record import tables
from evaluation.record.columns import EGO_COLUMNS, PARTNER_COLUMNS
from evaluation.record.record import Record
from tools.release_page.data import EGOS
from tools.release_page.folders import EGO_FILE, how_it_ran, small

_EGO_MEASURES = ("return", "return_sd", "success", "episodes", "nonfinite")


def collect_evaluation(folder: Path, summary: dict[str, Any], data: Path) -> Path:
    """Condense a finished evaluation; return the folder that was written.

    Raises:
        ValueError: The folder has one side of the split alone, or robots of several methods.
    """
    if not summary["m_test"] or not summary["m_train"]:
        raise ValueError(f"{folder} has only one side of the split; run evaluate with --split both")
    method, names = _egos(summary["egos"], folder)
    out = data / EGOS / f"{summary['task']}-{method}"
    pairs = pair_table(Record.read(folder))
    pairs = pairs.select(*EGO_COLUMNS, *PARTNER_COLUMNS, *_EGO_MEASURES).with_columns(
        pl.col("ego").replace_strict({ego: name for ego, (name, _) in names.items()}),
        pl.lit(method).alias("ego_algorithm"),
        pl.col("ego")
        .replace_strict({ego: seed for ego, (_, seed) in names.items()})
        .alias("ego_seed"),
    )
    tables.write_parquet(
        small(pairs.sort("ego_seed", maintain_order=True)), out / tables.PAIRS_FILE
    )
    egos = [names[ego][0] for ego in summary["egos"]]
    tables.write_json({**summary, "egos": egos}, out / tables.SUMMARY_FILE)
    tables.write_json(how_it_ran(folder, summary), out / tables.RUN_FILE)
    return out


def _egos(references: list[str], folder: Path) -> tuple[str, dict[str, tuple[str, int]]]:
    """Return the egos' one method, and each one's file name and seed."""
    matches = {reference: EGO_FILE.fullmatch(PurePath(reference).name) for reference in references}
    methods = {match["method"] for match in matches.values() if match}
    if None in matches.values() or len(methods) != 1:
        raise ValueError(
            f"{folder} evaluated {', '.join(references[:3])}; expected the policies of one "
            "train-ego run, such as runs/scratch-ppo/policies/ppo-s0.safetensors"
        )
    return methods.pop(), {
        name: (match[0], int(match["seed"])) for name, match in matches.items() if match
    }
