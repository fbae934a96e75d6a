"""Plays work with the real evaluator; machines of one kind return the same table.

A chunk is a job of its own with its partners in a fixed order, so its program and its values depend
on nothing else: not on other chunks, not on how many workers there are. Jobs are made and played by
what `assistax_zoo.evaluate` plays with, `evaluation.play`.
"""

import hashlib
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_board.robots.admission import Admission, robot_sizes
from assistax_board.rules.catalogue import Catalogue, version_id
from assistax_board.rules.release_pack import hidden_partners, ordinal_index, unpack
from assistax_board.rules.scoring import COLUMNS, GENTLE_COLUMNS, OWN, WISH_COLUMNS, Work


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
        self._sizes = robot_sizes(registry)
        self._admission = Admission(self._sizes)

    def versions(self) -> tuple[str, ...]:
        """Return the ids of the versions that this installation scores."""
        identities = map(self._catalogue.identity, self._catalogue.tasks)
        return tuple(version_id(identity) for identity in identities)

    def play(self, work: Work, robot: Any, release: bytes | None) -> pl.DataFrame:
        """Return one row an episode; see `scoring.Scorer`."""
        egos = self._egos(work, robot)
        if release is None:
            pairs = [(self._registry.policy(name), name) for name in work.partners]
            return self._play(work, egos, self._registry, pairs)
        with tempfile.TemporaryDirectory() as folder:
            hidden = unpack(release, Path(folder))
            humans = hidden_partners(hidden, work.task)
            pairs = [(humans[ordinal_index(name)], name) for name in work.partners]
            return self._play(work, egos, hidden, pairs)

    def _play(
        self, work: Work, egos: Any, registry: Any, pairs: Sequence[tuple[Any, str]]
    ) -> pl.DataFrame:
        from evaluation.cast.cast import env_version, own_robots
        from evaluation.cast.roster import registry_roster
        from evaluation.figures.normalised import REFERENCE_ROWS
        from evaluation.play.baselines import reference_job
        from evaluation.play.evaluator import run_job
        from evaluation.play.how import PlaySettings
        from evaluation.play.study import make_job

        entries = [entry for entry, _ in pairs]
        version = env_version(registry, work.task, entries)
        own = all(entry.spec.own_preferences for entry in entries)
        names = () if own else work.preferences
        seed, preferences = int(work.seed, 16), ",".join(names) or None
        how = PlaySettings(work.task, work.episodes, seed, self._backend, preferences=preferences)
        env, job = make_job(how, egos, registry_roster(registry, entries), version=version)
        if work.kind == "reference" and work.format in REFERENCE_ROWS:
            job = reference_job(env, job, str(work.format), own_robots(registry, entries))
        with tempfile.TemporaryDirectory() as folder:
            table = run_job(env, job, Path(folder) / "job").table
        return _leaving(table, {entry.id: name for entry, name in pairs})

    def _egos(self, work: Work, robot: Any) -> Any:
        from evaluation.cast.roster import Member, Roster, registry_roster
        from evaluation.figures.normalised import REFERENCE_ROWS
        from evaluation.play.baselines import reference_roster
        from population.networks.stack import stack_policies

        if work.kind == "reference" and work.format in REFERENCE_ROWS:
            return reference_roster(*self._sizes[work.task])
        if work.kind == "reference":
            ego = self._registry.policy(f"{work.task}/{work.format}/robot")
            return registry_roster(self._registry, [ego])
        admitted = self._admission.read(robot, work.task)
        member = Member("robot", hashlib.sha256(robot).hexdigest())
        stacks = stack_policies([(member.id, admitted.spec, admitted.params)])
        return Roster(stacks, {member.id: member})


def _leaving(table: pl.DataFrame, names: dict[str, str]) -> pl.DataFrame:
    """Return the columns that leave a worker, partners under the names that they were asked by."""
    renamed = table.with_columns(
        pl.col("partner").replace_strict(names),
        pl.col("partner_algorithm").alias("algorithm"),
        pl.col("partner_disability").alias("disability"),
    )
    if "violated" in renamed.columns and "preference" not in renamed.columns:
        renamed = renamed.with_columns(preference=pl.lit(OWN))  # of persons
    leaving = *COLUMNS, *GENTLE_COLUMNS, *WISH_COLUMNS
    return renamed.select(name for name in leaving if name in renamed.columns)
