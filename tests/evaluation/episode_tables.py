"""Episode tables made of given returns."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_base.digest import sha256
from evaluation.figures.summary import Context, SplitName
from evaluation.record import manifest as provenance
from evaluation.record import tables
from evaluation.record.record import Record

Team = tuple[str, str, int]  # algorithm, disability, seed
CONTEXT = Context(
    task="scratch",
    split=SplitName("scratch-half-v0", "0" * 64),
    release="v0",
    env_version=1,
    backend="native",
    env_steps_per_second=40_000.0,
)


def team_id(team: Team) -> str:
    return f"scratch/{team[0]}-{team[1]}-s{team[2]}-v0"


def teams(
    count: int, algorithms: Sequence[str] = ("ippo",), disabilities: Sequence[str] = ("d1",)
) -> list[Team]:
    """Return teams with every algorithm and disability in turn."""
    kinds = itertools.cycle(itertools.product(algorithms, disabilities))
    return [(*next(kinds), seed) for seed in range(count)]


def recorded(table: pl.DataFrame, folder: Path = Path("nowhere")) -> Record:
    """Return the record of a table that was made here."""
    return Record(table, folder)


def sealed(folder: Path, made_with: Mapping[str, str] | None = None, **changed: Any) -> Path:
    """Write the manifest that fits a folder's episodes and files, and return the folder.

    `changed` replaces fields of its identity; a field that is None is removed.
    """
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    partners = table.select("partner", "partner_disability", "side").unique().sort("partner")
    identity = {
        "task": CONTEXT.task,
        "stochastic": False,
        "egos": [[name, sha256(name.encode())] for name in table["ego"].unique().sort()],
        "partners": [[*row, sha256(row[0].encode()), None] for row in partners.iter_rows()],
        "episodes": table["episode"].n_unique(),
        "paired": False,
        "software": {"jax": "0.7.0"},
        **changed,
    }
    identity = {name: value for name, value in identity.items() if value is not None}
    job = provenance.identity_digest(identity)
    content = {"identity": identity, "job": job, "made_with": made_with or {}}
    provenance.write_manifest(folder, content)
    provenance.seal(folder)
    return folder


def episode_table(
    returns: np.ndarray,
    egos: Sequence[Team | str],
    partners: Sequence[Team],
    sides: Sequence[str | None] | None = None,
) -> pl.DataFrame:
    """Return the table of returns [E, P, K]; an ego given as text is from outside the zoo."""
    rows = []
    columns = "team", "algorithm", "disability", "seed"
    for (e, ego), (p, partner) in itertools.product(enumerate(egos), enumerate(partners)):
        robot = (None,) * 4 if isinstance(ego, str) else (team_id(ego), *ego)
        human = (team_id(partner), *partner)
        for k, value in enumerate(returns[e, p]):
            rows.append(
                {
                    "ego": ego if isinstance(ego, str) else f"{team_id(ego)}/robot",
                    **{f"ego_{name}": v for name, v in zip(columns, robot, strict=True)},
                    "partner": f"{team_id(partner)}/human",
                    **{f"partner_{name}": v for name, v in zip(columns, human, strict=True)},
                    "side": sides[p] if sides else None,
                    "episode": k,
                    "key": 100 + k,
                    "return": float(value),
                    "discounted_return": 0.5 * float(value),
                    "term_reach_target": 0.25 * float(value),
                    "term_scratch": 0.75 * float(value),
                    "success": bool(value > 0),
                    "force_mean": 1.0,
                    "force_peak": 2.0,
                    "first_contact": 100,
                    "distance_mean": 0.1,
                    "robot_travel": 50.0,
                    "human_travel": 20.0,
                    "nonfinite": False,
                    "steps": 1000,
                }
            )
    return pl.DataFrame(rows, infer_schema_length=None)


def clustered_matrix(count: int, clusters: int, seed: int = 0) -> np.ndarray:
    """Return a matrix [T, T] of 900 within a cluster and 300 less across.

    Team t is in cluster t mod clusters.
    """
    rng = np.random.default_rng(seed)
    group = np.arange(count) % clusters
    matrix = 900.0 - 300.0 * (group[:, None] != group[None, :]) + rng.normal(0, 10, (count, count))
    return matrix + 40.0 * np.eye(count)
