"""Which pair of a finished folder is worth a look first: the one that earns least."""

from pathlib import Path
from typing import Any

import polars as pl

from evaluation.record import tables
from evaluation.record.manifest import read_manifest
from evaluation.record.verification import check_whole
from evaluation.report.page import film_of, first_preferences


def worst_pair(folder: Path) -> dict[str, Any]:
    """Return the pair of a folder that earns least, as arguments of `trajectories`.

    Raises:
        ValueError: The folder is damaged, or its manifest does not name the episodes.
    """
    check_whole(folder)
    manifest = read_manifest(folder)
    if manifest is None or film_of(folder) is None:
        raise ValueError(f"{folder} does not name the episodes that it played; run again")
    identity, table = manifest["identity"], tables.read_episodes(folder / tables.EPISODES_FILE)
    means = table.group_by("ego", "partner").agg(pl.col("return").mean())
    robot, human, _ = means.sort("return", "ego", "partner").row(0)
    liked = first_preferences(folder).get(human) if "preferences" in identity else None
    seats = {"robot": robot, "human": human, "task": str(identity["task"])}
    return seats | {"seed": int(identity["seed"]), "preference": liked}
