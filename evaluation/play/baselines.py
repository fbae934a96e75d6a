"""What to read returns beside: zero and random actions, the script, each partner's own robot.

And a human that does nothing: what a robot earns with it, it earns without coordination. Episodes
are kept by the hash of their job and played once: only those of the policies under evaluation with
the passive human depend on these.
"""

import dataclasses
import functools
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
from evaluation.play.progress import OnProgress, Progress
from evaluation.record import tables
from population.networks.seat import Seat
from population.networks.stack import PolicyStack

_VERSION = "1"  # of what zero and random do; part of their digests


def reference_roster(observation_size: int, action_size: int) -> Roster:
    """Return the two egos that look at nothing, for a robot of these sizes."""
    spec = ReferenceSpec("robot", observation_size, action_size)
    amplitude = np.array([0, 1], np.float32)
    members = {name: Member(name, f"{name}-{_VERSION}") for name in (ZERO, RANDOM)}
    return Roster((PolicyStack(spec, tuple(members), {"amplitude": amplitude}),), members)


def reference_jobs(env: Any, job: Job, own: tuple[Roster, Roster] | None) -> list[Job]:
    """Return what `play_references` plays."""
    sizes = _sizes(env, "robot")
    scripts = [_script(job, sizes)] if job.task in SCRIPTS else []
    robots = joined(reference_roster(*sizes), *scripts)
    jobs = [dataclasses.replace(job, egos=robots, stochastic=False)]
    if own:
        jobs.append(reference_job(env, job, SELF_PLAY, own))
    if scripts:
        # Drawn actions are the policies' own; nothing is drawn of a script's.
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
    """Return the scripted robot of a task, whose digest is the hash of its code."""
    spec = ScriptSpec("robot", observation_size, action_size, task=task)
    modules = inspect.getmodule(SCRIPTS[task].play), chain
    digest = sha256("".join(map(inspect.getsource, filter(None, modules))).encode())
    return _single(spec, Member(SCRIPT, digest))


def passive_roster(observation_size: int, action_size: int) -> Roster:
    """Return a human without an impairment that does nothing."""
    spec = ReferenceSpec("human", observation_size, action_size)
    return _single(spec, Member(PASSIVE, f"{PASSIVE}-{_VERSION}", disability="d1"))


def _script(job: Job, sizes: tuple[int, int]) -> Roster:
    return script_roster(job.task, *sizes)


def _sizes(env: Any, role: str) -> tuple[int, int]:
    """Return the widths of a seat's observations and actions."""
    return env.observation_size[role], env.action_size[role]


def _single(spec: Seat, member: Member) -> Roster:
    """Return the one policy of a spec, without an amplitude."""
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
    """Return the reference egos' episodes with a job's partners, and the files that keep them.

    A column `reference` says whose they are.

    Args:
        env: The environment.
        job: The evaluation: its partners, episodes and seed are taken.
        own: Robots beside their own humans, see `evaluation.cast.roster.paired_rosters`.
        folder: Keeps a folder for each job, named by its hash; what is there and whole is not
            played again.
        max_envs: Most simulations at once.
        on_progress: Told how far a run is.
    """

    def report(what: str, state: Progress) -> None:
        if on_progress is not None:
            on_progress(dataclasses.replace(state, what=what))

    options: dict[str, Any] = {"max_envs": max_envs, "kept": True}
    played, files = [], []
    for reference in reference_jobs(env, job, own):
        passive = reference.partners.ids == (PASSIVE,)
        what = "robots with a passive human" if passive else "reference egos"
        shown = functools.partial(report, what)
        place = folder / reference.digest()[:20]
        played.append(run_job(env, reference, place, on_progress=shown, **options).table)
        files.append(place / tables.EPISODES_FILE)
    return pl.concat([with_names(table) for table in played]), files


def with_names(played: pl.DataFrame) -> pl.DataFrame:
    """Add the column `reference`: whose the episodes are.

    Which actions of a robot from outside were clipped is told of its own episodes alone.
    """
    names = (
        pl.when(pl.col("partner") == PASSIVE)
        .then("partner")
        .when(pl.col("ego").is_in([ZERO, RANDOM, SCRIPT]))
        .then("ego")
        .otherwise(pl.lit(SELF_PLAY))
    )
    return played.drop("clipped", strict=False).with_columns(names.alias(COLUMN))
