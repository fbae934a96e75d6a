"""The pair of a finished folder with the lowest return, to look at first."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.errors import shorten
from evaluation.cast.cast import env_version
from evaluation.record import tables
from evaluation.record.manifest import read_manifest
from evaluation.record.verification import check_whole
from evaluation.replay.received import received_robots, source_of
from evaluation.report.page import film_of, first_preferences
from zoo.registry import Registry


def worst_pair(folder: Path, registry: Registry, *, run_code: bool = False) -> dict[str, Any]:
    """Return the pair of a folder with the lowest return, as arguments of `trajectories`.

    Args:
        folder: The folder, not trusted.
        registry: The registry of its humans, and of its published robots.
        run_code: See `evaluation.replay.received.received_robots`.

    Raises:
        ValueError: The folder is damaged, or its manifest does not name the episodes; or the pair
            cannot be played here, or is not the one that played.
    """
    check_whole(folder)
    manifest = read_manifest(folder)
    if manifest is None or film_of(folder) is None:
        raise ValueError(f"{folder} does not name the episodes that it played; run again")
    identity, table = manifest["identity"], tables.read_episodes(folder / tables.EPISODES_FILE)
    means = table.group_by("ego", "partner").agg(pl.col("return").mean())
    robot, human, _ = means.sort("return", "ego", "partner").row(0)
    task = str(identity["task"])
    played = [row for row in identity["egos"] if row[0] == robot]
    received_robots(folder, played, registry, task, run_code=run_code)
    _check_human(folder, identity, human, registry)
    preference = first_preferences(folder).get(human) if "preferences" in identity else None
    seats = {"robot": source_of(robot, folder, registry, run_code=run_code), "human": human}
    return seats | {"task": task, "seed": int(identity["seed"]), "preference": preference}


def _check_human(folder: Path, identity: Mapping[str, Any], name: str, registry: Registry) -> None:
    """Raise a ValueError if a human of the folder differs from the registry's."""
    entry = registry.policy(name)
    version = env_version(registry, entry.task, [entry])
    expected = [entry.task, version, [name, entry.sha256]]
    digests = [[row[0], row[3]] for row in identity["partners"] if row[0] == name]
    if expected != [identity["task"], identity["env_version"], *digests]:
        raise ValueError(
            f"human {shorten(name)} is not the one that played in {folder}: another sha256 or "
            "environment; give the registry that it was evaluated with"
        )
