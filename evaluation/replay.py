"""Play a sample of a finished folder again: are these figures those of this job?

Whole tiles are replayed, so that each episode stands in the same row of the same program as it did.
On the same kind of machine every value must then be the same to the last bit. Elsewhere processors
and compilers round differently, and contacts amplify that: there the mean of the paired differences
must lie within what such noise makes.
"""

import dataclasses
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from evaluation import provenance, tables
from evaluation.egos import read_egos
from evaluation.evaluator import plan_of
from evaluation.jobs import Chunk, Job
from evaluation.policy_reference import parse_reference
from evaluation.roster import registry_roster
from evaluation.runner import Runner
from zoo.registry import Registry

DETERMINISTIC = ("native", "fused")  # backends that, on one kind of CPU, always give the same bits
STANDARD_ERRORS = 4.0  # of the mean difference, which another machine may give
MARGIN = 0.01  # and of the mean return
KEYS = ["ego", "partner", "episode"]


@dataclasses.dataclass(frozen=True)
class ReplayReport:
    """What playing a sample again gave."""

    folder: str
    episodes: int  # played again
    exact: bool  # whether they were compared bit by bit
    why: str  # they were, or were not
    differing: int  # episodes with any other value; on another machine most have
    difference: float  # mean return, found less kept
    tolerance: float  # 0 where compared bit by bit
    ok: bool


def replay_folder(
    folder: Path, registry: Registry, *, sample: int = 20, seed: int = 0, run_code: bool = False
) -> ReplayReport:
    """Play at least `sample` episodes of a finished folder again, and compare them.

    Args:
        folder: Filled by an evaluation or a cross-play; may be received from anybody.
        registry: Has its partners, and its robots if they are published.
        sample: Episodes; whole tiles are played, so there may be more.
        seed: Of the choice of tiles.
        run_code: Run robots that are Python code: the folder says which, so trust it first.

    Raises:
        ValueError: The folder is not what was written, or its job cannot be played here.
    """
    if sample < 1:
        raise ValueError(f"sample is {sample}; give at least 1 (--sample 20)")
    if problems := provenance.verify_folder(folder).problems:
        raise ValueError(f"{problems[0]}; a folder that was changed is not replayed")
    manifest = provenance.read_manifest(folder) or {}
    try:
        env, job = _rebuild(manifest["identity"], registry, run_code)
        tiles = [tile for chunk in plan_of(job, manifest) for tile in chunk.tiles]
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"the manifest of {folder} names no job: {error!r}") from error
    parts: list[pl.DataFrame] = []
    runner = Runner(env, job)
    for place in np.random.default_rng(seed).permutation(len(tiles)):
        chunk = Chunk(0, (tiles[place],))
        runner.run([chunk], lambda _, rows: parts.append(rows))
        if sum(part.height for part in parts) >= sample:
            break
    found = pl.concat(parts).sort(KEYS)
    kept = tables.read_episodes(folder / tables.EPISODES_FILE)
    kept = kept.join(found, on=KEYS, how="semi").sort(KEYS)
    return _compare(folder, kept, found, *_comparable(manifest, job))


def _rebuild(identity: Mapping[str, Any], registry: Registry, run_code: bool) -> tuple[Any, Job]:
    """Return the environment and the job that a manifest names, policies held to their hashes."""
    from assistax_envs import make

    egos = [row[0] for row in identity["egos"]]
    code = [name for name in egos if parse_reference(name).kind == "python"]
    if code and not run_code:
        raise ValueError(
            f"robot {code[0]} is code, and the folder names it; read it, then add --run-code"
        )
    env = make(identity["task"], backend=identity["backend"])
    partners = [registry.policy(row[0]) for row in identity["partners"]]
    job = Job(
        task=identity["task"],
        env_version=env.version,
        backend=env.backend,
        engine=getattr(env, "engine", {}),
        egos=read_egos(egos, registry, identity["task"]),
        partners=registry_roster(registry, partners),
        episodes=identity["episodes"],
        seed=identity["seed"],
        stochastic=identity["stochastic"],
        sides={row[0]: row[2] for row in identity["partners"] if row[2]},
        paired=identity["paired"],
        apart=identity["apart"],
        preferences=tuple(identity.get("preferences", ())),
        side_preferences=identity.get("side_preferences", {}),
        series=identity.get("series", 1),
    )
    here = job.identity()
    for name in ("env_version", "evaluator_version", "egos", "partners"):
        if here[name] != identity[name]:
            raise ValueError(
                f"{name} differ: the folder's are not those of this registry and installation; "
                "install the version that made it, or give its --registry"
            )
    return env, job


def _comparable(manifest: Mapping[str, Any], job: Job) -> tuple[bool, str]:
    """Return whether every bit must be the same here, and why or why not."""
    made, there = manifest.get("made_with", {}), manifest["identity"]
    pairs = {
        "processor": (made.get("processor"), provenance.processor()),
        "jaxlib": (made.get("versions", {}).get("jaxlib"), version("jaxlib")),
        "engine": (there["engine"], dict(job.engine)),
        "software": (there["software"], job.identity()["software"]),
    }
    differing = [name for name, (one, other) in pairs.items() if one != other]
    if differing:
        return False, f"other {', '.join(differing)} than where it was made"
    if job.backend not in DETERMINISTIC:
        return False, f"{job.backend} rounds differently from run to run"
    return True, "same processor, jaxlib and engine"


def _compare(
    folder: Path, kept: pl.DataFrame, found: pl.DataFrame, exact: bool, why: str
) -> ReplayReport:
    found = found.select(pl.col(name).cast(kept.schema[name]) for name in kept.columns)
    same = [kept[name].eq_missing(found[name]).to_numpy() for name in kept.columns]
    differing = int((~np.all(same, axis=0)).sum())
    gaps = (found["return"] - kept["return"]).to_numpy().astype(float)
    error = gaps.std(ddof=1) / np.sqrt(gaps.size) if gaps.size > 1 else 0.0
    noise = STANDARD_ERRORS * error + MARGIN * abs(kept["return"].to_numpy().astype(float).mean())
    ok = differing == 0 if exact else abs(gaps.mean()) <= noise
    return ReplayReport(
        folder=str(folder),
        episodes=kept.height,
        exact=exact,
        why=why,
        differing=differing,
        difference=float(gaps.mean()),
        tolerance=0.0 if exact else float(noise),
        ok=bool(ok),
    )
