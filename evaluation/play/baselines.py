"""Reference policies for comparison: zero and random actions, the script, partners' own robots.

A passive human shows the return that a robot earns without coordination. Episodes are cached by the
hash of their job and played once. Only those of the evaluated robots with the passive human depend
on the evaluated robots.
"""

import dataclasses
import inspect
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_base.digest import sha256
from assistax_envs.tasks import chain
from assistax_envs.tasks.chain import SCRIPTS
from evaluation.cast.baseline_policies import ReferenceSpec, ScriptSpec
from evaluation.cast.roster import Member, Roster, joined
from evaluation.figures.normalised import COLUMN, PASSIVE, RANDOM, SCRIPT, SELF_PLAY, ZERO
from evaluation.play.evaluator import run_job
from evaluation.play.jobs import Job
from evaluation.play.progress import OnProgress, staged
from evaluation.record import tables
from population.networks.seat import Seat
from population.networks.stack import PolicyStack

_VERSION = "1"  # of the zero and the random policy; part of their digests


def reference_roster(observation_size: int, action_size: int) -> Roster:
    """Return the roster of the zero and the random robot, for these sizes."""
    spec = ReferenceSpec("robot", observation_size, action_size)
    amplitude = np.array([0, 1], np.float32)
    members = {name: Member(name, f"{name}-{_VERSION}") for name in (ZERO, RANDOM)}
    return Roster((PolicyStack(spec, tuple(members), {"amplitude": amplitude}),), members)


def reference_jobs(env: Any, job: Job, own: tuple[Roster, Roster] | None) -> list[Job]:
    """Return the jobs of all references to `job`, of which some exist only with a script or `own`.

    They are zero, random and scripted robots with the job's partners; `own` self-play pairs; and
    the script and the job's robots with the passive human. None has columns of installed packages.
    """
    job = dataclasses.replace(job, metrics={})
    sizes = _sizes(env, "robot")
    scripts = [_script(job, sizes)] if job.task in SCRIPTS else []
    robots = joined(reference_roster(*sizes), *scripts)
    jobs = [dataclasses.replace(job, egos=robots, stochastic=False)]
    if own:
        jobs.append(reference_job(env, job, SELF_PLAY, own))
    if scripts:
        # If actions are drawn, the script plays a job of its own, without drawing.
        alone = [*scripts, job.egos] if job.stochastic else [joined(job.egos, *scripts)]
        human = passive_roster(*_sizes(env, "human"))
        jobs += [
            dataclasses.replace(
                job,
                egos=egos,
                partners=human,
                sides={},
                stochastic=job.stochastic and egos is job.egos,
            )
            for egos in alone
        ]
    return jobs


def reference_job(env: Any, job: Job, name: str, own: tuple[Roster, Roster] | None = None) -> Job:
    """Return a job with its robots replaced by one reference: an ego, or self-play with `own`."""
    if name == SELF_PLAY and own is not None:
        return dataclasses.replace(job, egos=own[0], partners=own[1], paired=True)
    sizes = _sizes(env, "robot")
    if name == SCRIPT:
        return dataclasses.replace(job, egos=_script(job, sizes), stochastic=False)
    both = reference_roster(*sizes)
    [stack] = both.stacks
    assert isinstance(stack, PolicyStack)
    egos = Roster((stack.take([stack.ids.index(name)]),), {name: both.members[name]})
    return dataclasses.replace(job, egos=egos, stochastic=False)


def script_roster(task: str, observation_size: int, action_size: int) -> Roster:
    """Return the scripted robot of a task and version; its digest is the hash of its code."""
    spec = ScriptSpec("robot", observation_size, action_size, task=task)
    modules = inspect.getmodule(SCRIPTS[task].play), chain
    digest = sha256("".join(map(inspect.getsource, filter(None, modules))).encode())
    return _single(spec, Member(SCRIPT, digest))


def passive_roster(observation_size: int, action_size: int) -> Roster:
    """Return a human without impairment whose actions are zero."""
    spec = ReferenceSpec("human", observation_size, action_size)
    return _single(spec, Member(PASSIVE, f"{PASSIVE}-{_VERSION}", disability="d1"))


def _script(job: Job, sizes: tuple[int, int]) -> Roster:
    return script_roster(job.task, *sizes)


def _sizes(env: Any, role: str) -> tuple[int, int]:
    """Return the widths of a seat's observations and actions."""
    return env.observation_size[role], env.action_size[role]


def _single(spec: Seat, member: Member) -> Roster:
    """Return a roster of one policy, with amplitude 0."""
    params = {"amplitude": np.zeros(1, np.float32)}
    return Roster((PolicyStack(spec, (member.id,), params),), {member.id: member})


def play_references(
    env: Any,
    job: Job,
    own: tuple[Roster, Roster] | None,
    folder: Path,
    *,
    max_envs: int | None = None,
    on_progress: OnProgress = None,
) -> tuple[pl.DataFrame, list[Path]]:
    """Return the episodes of all `reference_jobs`, and the files that cache them.

    The table's column `reference` names the reference of each episode.

    Args:
        env: The environment.
        job: The evaluation, whose partners, episodes and seed are used.
        own: Robots beside their own humans, see `evaluation.cast.roster.paired_rosters`.
        folder: The cache, with a folder for each job, named by its hash. Undamaged jobs are not
            played again.
        max_envs: Most simulations at once.
        on_progress: Called with the progress of a run.
    """
    options: dict[str, Any] = {"max_envs": max_envs, "kept": True}
    played, files = [], []
    jobs = reference_jobs(env, job, own)
    for stage, reference in enumerate(jobs, start=2):  # the evaluation itself is the first
        what = "partners with their own robots" if reference.paired else "reference robots"
        if reference.partners.ids == (PASSIVE,):
            what = "robots with a passive human"
        shown = staged(on_progress, stage, 1 + len(jobs), what)
        place = folder / reference.digest()[:20]
        played.append(run_job(env, reference, place, on_progress=shown, **options).table)
        files.append(place / tables.EPISODES_FILE)
    return pl.concat([with_names(table) for table in played]), files


def with_names(played: pl.DataFrame) -> pl.DataFrame:
    """Return the table with the column `reference`: partner, ego or self-play by its policies.

    The column `clipped` is dropped, because it is reported for the evaluation's own episodes only.
    """
    names = (
        pl.when(pl.col("partner") == PASSIVE)
        .then("partner")
        .when(pl.col("ego").is_in([ZERO, RANDOM, SCRIPT]))
        .then("ego")
        .otherwise(pl.lit(SELF_PLAY))
    )
    return played.drop("clipped", strict=False).with_columns(names.alias(COLUMN))
