"""Make the job of a received folder again from the registry, and compare the folder with it.

Policies' names, seed and flags are read from the manifest. Parameters, sides, settings and
environment are taken from the registry and the installation.
"""

import dataclasses
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from assistax_base.errors import SplitError
from assistax_envs.models.build import scene_sha256
from evaluation.cast.cast import (
    entries_of,
    env_version,
    groups_beside_teams,
    in_release,
    roots_of,
    sides_of,
)
from evaluation.cast.met_partners import DECLARED, MetPartners, declare, met_partners
from evaluation.cast.roster import Roster, registry_roster
from evaluation.figures.summary import Context, CrossPlaySummary, EvaluationSummary, read_summary
from evaluation.play.evaluator import MAX_ENVS, Evaluation
from evaluation.play.jobs import Job
from evaluation.play.study import context_of
from evaluation.play.tiles import GPU_TILE_ENVS, TILE_ENVS
from evaluation.record.alike import COLUMNS
from evaluation.record.manifest import describe_sources
from evaluation.record.record import Record
from evaluation.replay.headline import Headline, headline_of
from evaluation.replay.metrics import ReceivedMetrics, received_metrics
from evaluation.replay.received import received_robots
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split

LARGEST_TILE = 1 << 20  # simulations, on backends where the user may choose


@dataclasses.dataclass(frozen=True)
class RebuiltJob:
    """The job and metadata that a folder must agree with."""

    env: Any
    job: Job
    split: Split | None
    partners: Sequence[PolicyEntry]  # in the registry's order
    context: Context
    met: MetPartners
    headline: Headline
    tile_envs: int
    unchecked: tuple[str, ...]
    metrics: ReceivedMetrics


def rebuild_job(record: Record, registry: Registry, *, run_code: bool = False) -> RebuiltJob:
    """Return the job that a verified folder's record must be of.

    Raises:
        ValueError: It names another job than this registry and installation have, or robots that
            cannot be played here.
    """
    from assistax_envs import make

    folder, manifest = record.folder, record.manifest
    summary, identity = read_summary(folder), manifest["identity"]
    if identity.get("people"):
        raise ValueError(
            f"{folder} holds episodes of people, whose actions are in their logs; replay each log, "
            "or read the folder of logs anew"
        )
    task = identity["task"]
    partners = [registry.policy(row[0]) for row in identity["partners"]]
    split = _split_of(summary, registry, task)
    egos = received_robots(folder, identity["egos"], registry, task, run_code=run_code)
    declared = manifest.get("met", {}).get("declared")
    egos = declare(egos, registry, task, declared)
    played = [*partners, *(entry for entry in registry.policies if entry.id in egos.members)]
    version = env_version(registry, task, played)
    env = make(task, backend=identity["backend"], version=version)
    humans = registry_roster(registry, partners)
    job = _job_of(identity, env, egos, humans, sides_of(partners, split))
    metrics = received_metrics(identity, summary)
    job = dataclasses.replace(job, metrics=metrics.installed)
    _check_identity(identity, job)
    partners = registry.known(entry.id for entry in partners)
    result = Evaluation(record.table, summary.env_steps_per_second, 0.0)
    release, groups = _release(summary, split, played), groups_beside_teams(split)
    context = context_of(
        job, result, split=split, groups=groups, release=release, lock=registry.lock
    )
    if summary.lock and registry.lock is None:
        raise ValueError(
            f"{folder} was made under the lock {summary.lock[:12]}; give the lock's file as well"
        )
    return RebuiltJob(
        env,
        job,
        split,
        partners,
        dataclasses.replace(context, engine=identity["engine"]),
        met_partners(egos, partners),
        headline_of(summary),
        tile_envs_of(job.backend, manifest),
        (
            *_parts(summary, registry, job, split, partners),
            *[DECLARED] * bool(declared),
            *metrics.notes,
        ),
        metrics,
    )


def source_problems(
    manifest: Mapping[str, Any], registry: Registry, rebuilt: RebuiltJob, references: bool
) -> tuple[list[str], list[str]]:
    """Return problems of the manifest's sources against the registry, and unchecked claims."""
    entries = entries_of(registry, rebuilt.job.egos, rebuilt.partners, references)
    split = rebuilt.split.id if rebuilt.split else None
    expected = describe_sources(registry, entries, split, ())
    sources, recorded = manifest.get("sources"), manifest.get("registry")
    if not (isinstance(sources, dict) and isinstance(recorded, dict)):
        return [], ["what the folder was drawn from: its manifest does not name it"]
    problems = [
        f"the manifest's {name} are not those of the registry"
        for name in ("split", "releases")
        if sources.get(name) != expected[name]
    ]
    if recorded.get("lock") != registry.lock:
        problems.append("the manifest names another lock than the one that is given")
    if recorded.get("roots") != roots_of(registry, entries):
        unchecked = "the releases' roots: this registry has others, as one that grew or another has"
        return problems, [unchecked]
    return problems, []


def _split_of(
    summary: EvaluationSummary | CrossPlaySummary, registry: Registry, task: str
) -> Split | None:
    """Return the registry's split that the summary names, or None if a cross-play names none.

    Raises:
        SplitError: The registry's split has another hash.
        ValueError: An evaluation names no split, or a cross-play's is not a release's default.
    """
    if summary.split is None:
        if isinstance(summary, EvaluationSummary):
            raise ValueError("the evaluation names no split, and its sides are of none")
        return None
    split = registry.split(task, summary.split.id)
    if (split.id, split.sha256) != (summary.split.id, summary.split.sha256):
        raise SplitError(
            f"split {summary.split.id!r}", f"sha256 {split.sha256}", summary.split.sha256
        )
    default = registry.split(task, release=split.release)
    if isinstance(summary, CrossPlaySummary) and split != default:
        raise ValueError(f"split {split.id} is not a release's default, which a cross-play needs")
    return split


def _release(
    summary: EvaluationSummary | CrossPlaySummary,
    split: Split | None,
    played: Sequence[PolicyEntry],
) -> str:
    if isinstance(summary, EvaluationSummary) and split is not None:
        return split.release
    return ", ".join(sorted({entry.release for entry in played}))


def _job_of(
    identity: Mapping[str, Any], env: Any, egos: Roster, partners: Roster, sides: Mapping[str, str]
) -> Job:
    preferences = tuple(identity.get("preferences", ()))
    by_side = identity.get("side_preferences", {}) if preferences else {}
    return Job(
        task=identity["task"],
        env_version=env.version,
        backend=env.backend,
        engine=getattr(env, "engine", {}),
        scene=scene_sha256(identity["task"]),
        egos=egos,
        partners=partners,
        episodes=identity["episodes"],
        seed=identity["seed"],
        stochastic=identity["stochastic"],
        sides=sides,
        paired=False,  # of references alone
        own_episodes=identity["apart"],
        preferences=preferences,
        side_preferences={side: tuple(names) for side, names in by_side.items()},
        series=identity.get("series", 1),
    )


def _check_identity(identity: Mapping[str, Any], job: Job) -> None:
    """Raise a ValueError if an identity differs from the job's, except in versions."""
    here, engine = job.identity(), identity["engine"]
    if set(engine) == set(job.engine) and engine.get("name") == job.engine.get("name"):
        here["engine"] = engine
    here["software"] = identity["software"]
    if COLUMNS in identity:  # held against the episodes, and of packages that may be absent here
        here[COLUMNS] = identity[COLUMNS]
    texts = [{name: json.dumps(value) for name, value in part.items()} for part in (here, identity)]
    if differing := sorted(name for name, _ in texts[0].items() ^ texts[1].items()):
        raise ValueError(
            f"{', '.join(dict.fromkeys(differing))} differ: the folder's are not those of this "
            "registry and installation; install the version that made it, or give its registry"
        )


def tile_envs_of(backend: str, manifest: Mapping[str, Any]) -> int:
    """Return the largest number of simulations in a tile for the replay.

    On `native` and `fused`, it is the folder's, which must be one that this software uses: rows are
    equal to the last bit only in the same program. On other backends it is this software's own,
    because a folder with small tiles could have few of its episodes replayed.
    """
    most, chunk = manifest["tile_envs"], manifest["max_envs"]
    for name, value in (("tile_envs", most), ("max_envs", chunk)):
        if type(value) is not int or not 1 <= value <= LARGEST_TILE:
            raise ValueError(f"the manifest's {name} is {value!r}; allowed is 1 to {LARGEST_TILE}")
    known = {"native": (TILE_ENVS["native"],), "fused": (TILE_ENVS["fused"], GPU_TILE_ENVS)}
    if backend not in known:
        return MAX_ENVS[backend]
    if most not in known[backend]:
        numbers = " or ".join(map(str, known[backend]))
        raise ValueError(f"the manifest's tile_envs is {most}; on {backend} it is {numbers}")
    return most


def _parts(
    summary: EvaluationSummary | CrossPlaySummary,
    registry: Registry,
    job: Job,
    split: Split | None,
    partners: Sequence[PolicyEntry],
) -> list[str]:
    """Return notes on a split's side, or a release, of which only a part was played."""
    if isinstance(summary, EvaluationSummary) and split is not None:
        counts = [
            (f"{side} partners of split {split.id}", count, len(getattr(split, side)))
            for side, count in sorted(Counter(job.sides.values()).items())
        ]
    else:
        release, every = partners[0].release, f"{job.task}/*"
        counts = [
            (
                f"{role}s of {release}",
                len(seat.ids),
                len(in_release(registry, every, release, task=job.task, role=role)),
            )
            for role, seat in (("robot", job.egos), ("human", job.partners))
        ]
    return [f"{few} of {all_} {what} were played" for what, few, all_ in counts if few != all_]
