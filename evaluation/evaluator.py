"""Run a job chunk by chunk into a folder: resumable, and the table does not depend on how it was cut.

The folder holds `manifest.json` (the job, by its hash, and the plan's size), one Parquet part for each finished chunk,
and at the end `episodes.parquet` in their place.
"""

import dataclasses
import math
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars as pl

from assistax_envs import disability_params
from evaluation import tables
from evaluation.egos import call_ego
from evaluation.jobs import Chunk, Ego, Group, HostEgo, Job, Member, ReferenceSpec, plan
from evaluation.locks import LOCK_FILE, locked
from evaluation.reference_egos import ReferencePolicy
from evaluation.rollout import Rollout, Tally, episode_seeds
from population.policy import Policy
from population.spec import PolicySpec

MANIFEST_FILE = "manifest.json"
PARTS_FOLDER = "parts"
MAX_ENVS = {"native": 2048, "mjx": 16384, "mjx-warp": 32768}  # default bound of a chunk


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is, in environment steps of this process."""

    done: int
    total: int
    seconds: float  # spent in the environment and the networks, compilation not counted
    what: str = "policies"  # whose episodes these are

    @property
    def eta(self) -> float | None:
        """Seconds left at the speed so far; None before the first step."""
        return None if self.done == 0 else self.seconds * (self.total - self.done) / self.done


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """A finished job."""

    table: pl.DataFrame  # one row an episode, in the job's order of egos, partners and episodes
    env_steps_per_second: float | None  # padding and compilation not counted; None where everything was found finished
    compile_seconds: float


@dataclasses.dataclass(frozen=True)
class BlockDone:
    """A finished block of a job."""

    chunks: int  # of this block
    episodes: int
    all_chunks: int  # of the whole job
    missing: int  # chunks of the whole job that the folder still lacks


def run_job(
    env: Any,
    job: Job,
    folder: Path,
    *,
    max_envs: int | None = None,
    wait: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> Evaluation:
    """Evaluate every ego with every partner and write `episodes.parquet`.

    A folder of the same job is continued where it stopped, cut as it was begun; its table is that of a single run.
    Without `max_envs`, the bound of a chunk is that of `MAX_ENVS`. Where another process writes to the folder, `wait`
    for it or refuse.

    Raises:
        ValueError: the folder holds another job, or a policy reads other observations than the task gives.
        EgoError: a robot from outside failed; finished chunks are kept.
    """
    check_sizes(env, job)
    check_folder(folder)
    with locked(folder, wait=wait):
        return _run_and_merge(env, job, folder, max_envs, on_progress)


def run_block(
    env: Any,
    job: Job,
    folder: Path,
    block: tuple[int, int],
    *,
    max_envs: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> BlockDone:
    """Simulate the chunks of block (i, n), i from 1, and leave their parts in the folder.

    Blocks may share a folder or have one each, also on other machines; they must be cut alike, by the same `max_envs`.
    With the parts of all blocks in one folder, `run_job` merges them without simulating anything.
    """
    number, count = block
    if not 1 <= number <= count:
        raise ValueError(f"block is {number}/{count}; allowed are 1/{count} to {count}/{count}")
    check_sizes(env, job)
    check_folder(folder)
    own_lock = f"{LOCK_FILE}-{number}-of-{count}"
    with locked(folder, shared=True), locked(folder / PARTS_FOLDER, own_lock):
        chunks = plan(job, _open_folder(folder, job, max_envs or MAX_ENVS[job.backend]))
        mine = chunks[number - 1 :: count]
        if not (folder / tables.EPISODES_FILE).is_file():
            _simulate(env, job, folder, [chunk for chunk in mine if not _is_done(folder, chunk)], on_progress)
        missing = sum(not _is_done(folder, chunk) for chunk in chunks)
    return BlockDone(len(mine), sum(chunk.rows for chunk in mine), len(chunks), missing)


def _run_and_merge(
    env: Any, job: Job, folder: Path, max_envs: int | None, on_progress: Callable[[Progress], None] | None
) -> Evaluation:
    chunks = plan(job, _open_folder(folder, job, max_envs or MAX_ENVS[job.backend]))
    target = folder / tables.EPISODES_FILE
    missing = [] if target.is_file() else [chunk for chunk in chunks if not _is_done(folder, chunk)]
    runner = _simulate(env, job, folder, missing, on_progress)
    if not target.is_file():
        parts = pl.concat([pl.read_parquet(_part(folder, chunk)) for chunk in chunks])
        tables.write_episodes(_in_order(parts, job), target)
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)
    return Evaluation(tables.read_episodes(target), runner.speed, runner.compile_seconds)


def _simulate(
    env: Any, job: Job, folder: Path, chunks: list[Chunk], on_progress: Callable[[Progress], None] | None
) -> "_Runner":
    """Run chunks, leaving each one's part in the folder; return what ran them."""
    runner = _Runner(env, job, on_progress, sum(chunk.rows for chunk in chunks) * env.episode_length)
    runner.report()
    for chunk in chunks:
        tables.write_parquet(runner.run(chunk), _part(folder, chunk))
    return runner


def check_sizes(env: Any, job: Job) -> None:
    """Refuse policies whose seat, observations or actions are not this task's."""
    for seat, part, groups in (("robot", "ego", job.egos), ("human", "partner", job.partners)):
        for group in groups:
            if isinstance(group, HostEgo):
                continue
            spec, name = group.spec, group.members[0].id
            if spec.role != seat:
                raise ValueError(f"{name} is a {spec.role} policy; the {part} is the {seat}")
            for what, found, expected in (
                ("reads observations of", spec.observation_size, env.observation_size[seat]),
                ("gives actions of", spec.action_size, env.action_size[seat]),
            ):
                if found != expected:
                    raise ValueError(
                        f"{name} {what} {found} numbers; the {seat} of task {job.task} has {expected}: it was made for "
                        "another task, choose a policy of this one (`assistax-zoo list`)"
                    )


def check_folder(folder: Path) -> None:
    """Create an output folder, and find out now, not after the run, that it cannot be written."""
    try:
        with tables.atomic_path(folder / "writable.tmp") as probe:
            probe.write_bytes(b"")
        (folder / "writable.tmp").unlink()
    except OSError as error:
        raise OSError(f"cannot write to {folder} ({error.strerror or error}); choose another --out") from error


def _open_folder(folder: Path, job: Job, max_envs: int) -> int:
    """Begin or continue the folder's job; return the size its plan was begun with."""
    path = folder / MANIFEST_FILE
    found = tables.read_json(path) if path.is_file() else None
    if found is None:
        if (folder / tables.EPISODES_FILE).exists():
            raise ValueError(f"{folder} holds {tables.EPISODES_FILE} without {MANIFEST_FILE}; choose another --out")
        return _begin(path, job, max_envs)
    if found.get("job") != job.digest():
        identity = job.identity()
        differing = [name for name in identity if found.get(name) != identity[name]]
        raise ValueError(
            f"{folder} holds another job ({_difference(found, identity, differing)}); choose another --out or delete it"
        )
    if not any((folder / PARTS_FOLDER).glob("part-*")):
        return _begin(path, job, max_envs)
    return int(found["max_envs"])


def _begin(path: Path, job: Job, max_envs: int) -> int:
    tables.write_json({"job": job.digest(), "max_envs": max_envs, **job.identity()}, path)
    return max_envs


def _difference(found: dict[str, Any], expected: dict[str, Any], names: list[str]) -> str:
    told = []
    for name in names:
        here, there = expected[name], found.get(name)
        told.append(f"other {name}" if isinstance(here, (list, dict)) else f"{name} {there} there, {here} here")
    return ", ".join(told) or "a different hash"


class _Runner:
    """Runs chunks one after another, keeping what was compiled and where the parameters are."""

    def __init__(self, env: Any, job: Job, on_progress: Callable[[Progress], None] | None, total: int) -> None:
        self._env, self._job, self._on_progress = env, job, on_progress
        self._rollouts: dict[Any, Rollout] = {}
        self._done, self._total, self._seconds = 0, total, 0.0

    @property
    def speed(self) -> float | None:
        return self._done / self._seconds if self._done else None

    @property
    def compile_seconds(self) -> float:
        return sum((rollout.compile_seconds for rollout in self._rollouts.values()), start=0.0)

    def report(self) -> None:
        """Tell the caller how far the run is."""
        if self._on_progress is not None:
            self._on_progress(Progress(self._done, self._total, self._seconds))

    def run(self, chunk: Chunk) -> pl.DataFrame:
        """Simulate one chunk and return its rows, padding dropped."""
        job, (e, p, k) = self._job, chunk.shape
        ego, partner = job.egos[chunk.ego_group], job.partners[chunk.partner_group]
        partners = [partner.members[row] for row in _padded(chunk.partners, p)]
        rollout = self._rollout(ego, partner)
        host = isinstance(ego, HostEgo)
        before, began = rollout.compile_seconds, time.perf_counter()
        spent = 0.0

        def on_steps(steps: int) -> None:
            nonlocal spent
            now = time.perf_counter() - began - (rollout.compile_seconds - before)
            self._seconds, spent = self._seconds + now - spent, now
            self._done += steps * chunk.rows
            self.report()

        tally = self._run(
            rollout,
            chunk,
            None if host else _take(ego.params, chunk.egos, p if chunk.paired else e),
            _take(partner.params, chunk.partners, p),
            disability_params([str(member.disability) for member in partners]),
            episode_seeds(job.seed, _padded(chunk.episodes, k)),
            act=call_ego(ego, [member.id for member in partners], k, self._env.action_size["robot"]) if host else None,
            on_steps=on_steps,
        )
        return _rows(job, chunk, tally)

    def _run(self, rollout: Rollout, chunk: Chunk, *args: Any, **options: Any) -> Tally:
        """Run a rollout; where memory runs out, say what to do."""
        try:
            return rollout.run(*args, **options)
        except jax.errors.JaxRuntimeError as error:
            if "RESOURCE_EXHAUSTED" not in str(error):
                raise
            simulations = math.prod(chunk.shape)
            raise ValueError(
                f"out of memory with {simulations} simulations; use --max-envs {max(simulations // 2, 1)} or less"
            ) from error

    def _rollout(self, ego: Ego, partner: Group) -> Rollout:
        robot = None if isinstance(ego, HostEgo) else ego.spec
        key = robot, partner.spec
        if key not in self._rollouts:
            options = {"stochastic": self._job.stochastic, "paired": self._job.paired}
            self._rollouts[key] = Rollout(self._env, _policy(robot), _policy(partner.spec), **options)
        return self._rollouts[key]


def _policy(spec: PolicySpec | ReferenceSpec | None) -> Any:
    if isinstance(spec, ReferenceSpec):
        return ReferencePolicy(spec)
    return None if spec is None else Policy(spec)


def _padded(rows: range, width: int) -> list[int]:
    """Return the rows, the last repeated up to `width`."""
    return [rows[min(i, len(rows) - 1)] for i in range(width)]


def _take(params: Any, rows: range, width: int) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[_padded(rows, width)], params)


def _rows(job: Job, chunk: Chunk, tally: Tally) -> pl.DataFrame:
    """Return the real episodes of a chunk, ego by ego, partner by partner."""
    e, p, k = 1 if chunk.paired else len(chunk.egos), len(chunk.partners), len(chunk.episodes)
    tally = jax.tree.map(lambda leaf: leaf[:e, :p, :k].reshape(-1), tally)
    egos = _described("ego", [job.egos[chunk.ego_group].members[row] for row in chunk.egos])
    partners = _described("partner", [job.partners[chunk.partner_group].members[row] for row in chunk.partners])
    sides = [job.sides.get(name) for name in partners["partner"]]
    partners = partners.with_columns(pl.Series("side", sides, pl.String))
    episodes = pl.DataFrame({"episode": list(chunk.episodes), "key": episode_seeds(job.seed, chunk.episodes)})
    if chunk.paired:
        rows = pl.concat([egos, partners], how="horizontal")
    else:
        rows = egos.join(partners, how="cross", maintain_order="left_right")
    rows = rows.join(episodes, how="cross", maintain_order="left_right")
    measured = {
        "return": tally.returns,
        "discounted_return": tally.discounted,
        **{tables.TERM_PREFIX + name: value for name, value in tally.terms.items()},
        "success": tally.success,
        "force_mean": tally.force_sum / np.maximum(tally.steps, 1),
        "force_peak": tally.force_peak,
        "first_contact": np.where(tally.first_contact > 0, tally.first_contact, tally.steps),
        "distance_mean": tally.distance_sum / np.maximum(tally.steps, 1),
        **{f"{role}_travel": value for role, value in tally.travel.items()},
        "nonfinite": tally.nonfinite,
        "steps": tally.steps,
    }
    types = {name: tables.SCHEMA.get(name, pl.Float32()) for name in measured}
    return rows.with_columns(pl.Series(name, value).cast(types[name]) for name, value in measured.items())


def _described(seat: str, members: list[Member]) -> pl.DataFrame:
    """Return the columns of a seat, one row a member."""
    names = {seat: "id", **{f"{seat}_{name}": name for name in ("team", "algorithm", "disability", "seed")}}
    schema = {column: tables.SCHEMA[column] for column in names}
    return pl.DataFrame([[getattr(m, name) for name in names.values()] for m in members], schema=schema, orient="row")


def _in_order(table: pl.DataFrame, job: Job) -> pl.DataFrame:
    """Sort by the job's order, so that neither chunks nor resuming show."""
    for seat, groups in (("ego", job.egos), ("partner", job.partners)):
        ids = [member.id for group in groups for member in group.members]
        rank = pl.Series(range(len(ids)), dtype=pl.Int64)
        table = table.with_columns(pl.col(seat).replace_strict(ids, rank).alias(f"_{seat}"))
    return table.sort("_ego", "_partner", "episode").drop("_ego", "_partner")


def _part(folder: Path, chunk: Chunk) -> Path:
    return folder / PARTS_FOLDER / f"part-{chunk.index:05d}.parquet"


def _is_done(folder: Path, chunk: Chunk) -> bool:
    """Return whether a chunk's part is there and whole; a damaged one is simulated again."""
    path = _part(folder, chunk)
    if not path.is_file():
        return False
    try:
        return pl.read_parquet(path, columns=["key"]).height == chunk.rows
    except pl.exceptions.PolarsError:
        return False
