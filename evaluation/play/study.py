"""Steps that evaluation and cross-play share: the job, the folder's lock, and the record."""

import contextlib
import math
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from assistax_base.locks import locked
from evaluation.cast.cast import Cast
from evaluation.cast.roster import Roster
from evaluation.figures.metrics.installed import find_metrics
from evaluation.figures.summary import Context, SplitName
from evaluation.play.evaluator import Evaluation
from evaluation.play.how import PlaySettings
from evaluation.play.jobs import Job
from evaluation.record import manifest, tables
from evaluation.record.alike import check_alike, check_members, conditions, read_identity
from evaluation.record.verification import check_whole, strange_tables_refused
from population.views import View
from zoo.schema import Split

if TYPE_CHECKING:
    from assistax_envs import Env


def make_job(
    how: PlaySettings,
    robots: Roster,
    humans: Roster,
    sides: Mapping[str, str] | None = None,
    version: int | None = None,
) -> "tuple[Env, Job]":
    """Return the environment and the job of robots with humans, on their sides of a split.

    `version` is the environment's; the newest if not given. Its observations are those of the
    robots' view, which the job names.
    """
    from assistax_envs.models.build import scene_sha256

    view = robots.view
    numbers = _numbers_of(humans) if view is View.NUMBERS else None
    env = view.make(how.task, how.backend, version=version, numbers=numbers)
    episodes, turns = how.episodes_of_pair, how.turns
    if humans.own_preferences:
        turns = () if how.preferences is None else turns
    usual = max((stack.spec.episodes or 0 for stack in humans.policies), default=0)
    if usual:
        episodes = how.episodes or math.ceil(usual / how.series) * how.series
    job = Job(
        task=how.task,
        env_version=env.version,
        backend=env.backend,
        engine=getattr(env, "engine", {}),
        view=view,
        scene=scene_sha256(how.task),
        egos=robots,
        partners=humans,
        episodes=episodes,
        seed=how.seed,
        stochastic=how.stochastic,
        series=how.series,
        own_episodes=True,
        sides=sides or {},
        preferences=turns,
        metrics=find_metrics(how.metric_names),
    )
    return env, job


def _numbers_of(humans: Roster) -> np.ndarray | None:
    """Return the numbers of humans [P, W] by place in the roster; None if some have none."""
    tables = [stack.spec.numbers(stack.params) for stack in humans.policies]
    known = [table for table in tables if table is not None]
    return np.concatenate(known) if tables and len(known) == len(tables) else None


def context_of(
    job: Job,
    result: Evaluation,
    *,
    split: Split | None,
    groups: tuple[str, ...],
    release: str,
    lock: str | None,
) -> Context:
    """Return the run's metadata that is not in its table: task, engine, split, speed."""
    return Context(
        task=job.task,
        env_version=job.env_version,
        backend=job.backend,
        engine=job.view.engine(job.engine),
        release=release,
        split=SplitName(split.id, split.sha256, dict(split.preferences), groups) if split else None,
        lock=lock,
        env_steps_per_second=result.env_steps_per_second,
    )


def read_best_responses(crossplay: Path, job: Job) -> pl.DataFrame:
    """Return the pairs table of a finished cross-play, whose best robots are best responses.

    Partners with equal ids must be equal policies, played under the same conditions. Seed and
    number of episodes may differ.

    Raises:
        ValueError: The folder is damaged, or has other conditions or other partners.
    """
    check_whole(crossplay)
    if (identity := read_identity(crossplay)) is None:
        raise ValueError(f"{crossplay} does not name the job that it is of; run it again")
    both = {str(crossplay): identity, "this evaluation": job.identity()}
    advice = "best responses are of a cross-play that was played alike"
    with strange_tables_refused(crossplay):
        check_alike({name: _pair_conditions(of) for name, of in both.items()}, advice=advice)
        members = {name: _without_sides(of) for name, of in both.items()}
        check_members(members, "partners", advice=advice)
    pairs = tables.read_parquet(crossplay / tables.PAIRS_FILE)
    if not set(pairs["partner"]) & set(job.partners.ids):
        raise ValueError(f"{crossplay} has none of the partners that play here; give another")
    return pairs


def _pair_conditions(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return the conditions under which pairs play, without the choice of episodes."""
    omitted = ("seed", "episodes", "apart", "paired")
    return {name: value for name, value in conditions(identity).items() if name not in omitted}


def _without_sides(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return an identity without its partners' sides, which depend on the split."""
    return {**identity, "partners": [[*row[:2], None, *row[3:]] for row in identity["partners"]]}


@contextlib.contextmanager
def locked_if_current(job: Job, folder: Path) -> Generator[None]:
    """Lock a folder, or raise a ValueError if another process has replaced its job.

    So tables are written only beside the episodes that they are made of.
    """

    def check() -> None:
        if (manifest.read_manifest(folder) or {}).get("job") != job.digest():
            raise ValueError(
                f"the job of {folder} was replaced while this command ran; repeat it into another "
                "folder"
            )

    # Checked before the lock too, so that the process that replaced the job is not waited for.
    check()
    with locked(folder, wait=True):
        check()
        yield


def seal(
    folder: Path,
    cast: Cast,
    files: Iterable[Path] = (),
    robots: Mapping[str, Any] | None = None,
) -> None:
    """Write the hashes of a folder's files and of their sources into its manifest.

    Args:
        folder: The finished folder.
        cast: The cast of the study.
        files: Files outside the registry from which figures are made, beside the robots' own.
        robots: The result of `evaluation.play.robot_checks.describe_robots`.
    """
    findings = robots or {}
    members = cast.robots.members.values()
    # The robots' files have the hashes from when the robots played.
    hashed = [(path, sha256) for member in members for path, sha256 in member.files]
    hashed += [item for loaded in findings.get("loaded", {}).values() for item in loaded.items()]
    hashed += [(path, manifest.file_sha256(path)) for path in files]
    hashes = {str(Path(path).resolve()): sha256 for path, sha256 in hashed}
    record = {**cast.record, "sources": {**cast.record["sources"], "files": hashes}}
    manifest.seal(folder, **record, **({"robots": findings} if findings else {}))
