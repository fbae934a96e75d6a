"""Plays work with the real evaluator: the same table whoever plays it, on one kind of machine.

A chunk is a job of its own with its partners in a fixed order, so its program and its values depend
on nothing else: not on other chunks, not on how many workers there are.
"""

import functools
import hashlib
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_zoo.service.admission import Admission, robot_sizes
from assistax_zoo.service.catalogue import Catalogue, version_id
from assistax_zoo.service.release_pack import hidden_partners, ordinal_index, unpack
from assistax_zoo.service.scoring import Work


class ZooScorer:
    """Scores with a registry's partners, and with those of private releases."""

    def __init__(self, registry: Any, catalogue: Catalogue, backend: str) -> None:
        """Prepare to play.

        Args:
            registry: The public partners.
            catalogue: Says which versions this installation scores.
            backend: Of the environment.
        """
        self._registry, self._catalogue, self._backend = registry, catalogue, backend
        self._admission = Admission(robot_sizes(registry))

    def versions(self) -> tuple[str, ...]:
        """Return the ids of the versions that this installation scores."""
        identities = map(self._catalogue.identity, self._catalogue.tasks)
        return tuple(version_id(identity) for identity in identities)

    def play(self, work: Work, robot: Any, release: bytes | None) -> pl.DataFrame:
        """Return one row an episode; see `scoring.Scorer`."""
        ego = _live(robot) if work.kind == "live" else self._file(work, robot)
        if release is None:
            entries = [self._registry.policy(name) for name in work.partners]
            return self._play(work, ego, self._registry, entries)
        with tempfile.TemporaryDirectory() as folder:
            hidden = unpack(release, Path(folder))
            humans = hidden_partners(hidden, work.task)
            entries = [humans[ordinal_index(name)] for name in work.partners]
            return self._play(work, ego, hidden, entries)

    def _play(self, work: Work, ego: Any, registry: Any, entries: list[Any]) -> pl.DataFrame:
        from evaluation.evaluator import run_job
        from evaluation.jobs import Job
        from evaluation.roster import registry_roster

        env = _env(work.task, self._backend)
        job = Job(
            task=work.task,
            env_version=env.version,
            backend=env.backend,
            egos=ego,
            partners=registry_roster(registry, entries),
            episodes=work.episodes,
            seed=int(work.seed, 16),
        )
        with tempfile.TemporaryDirectory() as folder:
            table = run_job(env, job, Path(folder) / "job").table
        return _told(table, dict(zip([e.id for e in entries], work.partners, strict=True)))

    def _file(self, work: Work, data: bytes) -> Any:
        from evaluation.roster import Member, Roster
        from population.stack import PolicyStack, map_leaves

        robot = self._admission.read(data, work.task)
        member = Member("robot", hashlib.sha256(data).hexdigest())
        params = map_leaves(lambda leaf: np.asarray(leaf)[None], robot.params)
        stack = PolicyStack(robot.spec, (member.id,), params)
        return Roster((stack,), {member.id: member})


def _live(act: Any) -> Any:
    from evaluation.roster import HostEgo, Member, Roster

    return Roster((HostEgo("robot", act),), {"robot": Member("robot", "live")})


@functools.cache
def _env(task: str, backend: str) -> Any:
    from assistax_envs import make

    return make(task, backend=backend)


def _told(table: pl.DataFrame, names: dict[str, str]) -> pl.DataFrame:
    """Return the columns that leave a worker, partners under the names that they were asked by."""
    return table.select(
        pl.col("partner").replace_strict(names),
        pl.col("partner_algorithm").alias("algorithm"),
        pl.col("partner_disability").alias("disability"),
        pl.col("episode"),
        pl.col("return"),
        pl.col("success"),
        pl.col("nonfinite"),
    )
