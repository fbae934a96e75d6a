"""From released scores to the board of a task, computed anew only when a score was added."""

import dataclasses
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from assistax_zoo.service.pages.crossplays import CrossPlays
from assistax_zoo.service.queries import PartnerScore, Queries, Submission
from assistax_zoo.service.statistics_board import Method, Panel, Standing, standings
from assistax_zoo.service.vocabulary import REFERENCE
from evaluation.metrics import Bounds
from evaluation.relative import RANDOM, SELF_PLAY, ZERO

LOW = (RANDOM, ZERO)  # references that earn a normalised return of 0, the first there is
_NEWEST = 100_000  # submissions of a board; all of them


@dataclasses.dataclass(frozen=True)
class Played:
    """The submissions of one method, its seeds, and what they earned with every partner."""

    submissions: tuple[Submission, ...]  # the oldest first
    returns: np.ndarray  # [S, P, K]

    @property
    def newest(self) -> Submission:
        """The submission that stands for the method in addresses."""
        return self.submissions[-1]

    @property
    def is_reference(self) -> bool:
        """Whether the row is there to be measured by."""
        return self.newest.submitter == REFERENCE


@dataclasses.dataclass(frozen=True, eq=False)
class Board:
    """All methods of a task, under one version of everything that decides a score."""

    task: str
    version: str
    identity: Mapping[str, Any]
    partners: tuple[PartnerScore, ...]  # one of each partner, for its name and traits
    rows: tuple[tuple[Standing, Played], ...]  # the highest M_test first

    @property
    def episodes(self) -> int:
        """Episodes with each partner."""
        return self.rows[0][1].returns.shape[2]

    @property
    def methods(self) -> tuple[tuple[Standing, Played], ...]:
        """The rows that compete, the highest M_test first."""
        return tuple(row for row in self.rows if not row[1].is_reference)

    def of(self, submission: str) -> tuple[Standing, Played] | None:
        """Return the row that a submission is a seed of."""
        for standing, played in self.rows:
            if any(one.id == submission for one in played.submissions):
                return standing, played
        return None


class Boards:
    """The boards of all tasks, each kept until a submission to it is scored."""

    def __init__(self, queries: Queries, crossplays: CrossPlays) -> None:
        self._queries, self._crossplays = queries, crossplays
        self._lock = threading.Lock()
        self._kept: dict[str, tuple[object, Board | None]] = {}

    def of(self, task: str) -> Board | None:
        """Return the board of a task under its newest version, or None while it is empty."""
        versions = self._queries.versions(task)
        if not versions:
            return None
        version, identity = versions[0]
        scored = [
            one
            for one in self._queries.submissions(task=task, limit=_NEWEST)
            if one.state == "scored"
        ]
        key = (version, tuple((one.id, one.submitter) for one in scored))
        with self._lock:
            if self._kept.get(task, (None, None))[0] != key:
                self._kept[task] = key, self._compute(task, version, identity, scored)
            return self._kept[task][1]

    def _compute(
        self, task: str, version: str, identity: Mapping[str, Any], scored: Sequence[Submission]
    ) -> Board | None:
        scores = self._queries.partner_scores([one.id for one in scored], version)
        methods = group_methods(scored, scores)
        if not methods:
            return None
        partners = _panel(scores)
        references = {one.newest.method: one for one in methods if one.is_reference}
        panel = Panel(
            tuple(one.disability for one in partners),
            _bounds(partners, references, self._crossplays.of(task)),
        )
        by_name = {method.newest.id: method for method in methods}
        rows = standings(
            [Method(name, one.returns, not one.is_reference) for name, one in by_name.items()],
            panel,
        )
        named = tuple((row, by_name[row.name]) for row in rows)
        return Board(task, version, identity, partners, named)


def group_methods(
    submissions: Sequence[Submission], scores: Sequence[PartnerScore]
) -> list[Played]:
    """Put submissions of one submitter and method together: they are its seeds.

    A submission without a score from the whole panel is left out: it has yet to be scored under
    this version.
    """
    returns: dict[str, dict[str, tuple[float, ...]]] = {}
    for score in scores:
        returns.setdefault(score.submission, {})[score.partner] = score.returns
    partners = [one.partner for one in _panel(scores)]
    groups: dict[tuple[str, str], list[Submission]] = {}
    for one in sorted(submissions, key=lambda one: (one.created_at, one.id)):
        if returns.get(one.id, {}).keys() == set(partners):
            groups.setdefault((one.submitter, one.method), []).append(one)
    return [
        Played(
            tuple(group),
            np.array([[returns[one.id][partner] for partner in partners] for one in group]),
        )
        for group in groups.values()
    ]


def _panel(scores: Sequence[PartnerScore]) -> tuple[PartnerScore, ...]:
    """One score of each partner that any submission met, in order of names."""
    return tuple({one.partner: one for one in sorted(scores, key=lambda s: s.partner)}.values())


def _bounds(
    partners: Sequence[PartnerScore], references: Mapping[str, Played], crossplay: Any
) -> Bounds | None:
    """What a random robot earns with each partner, and the best robot known for it.

    That is its own robot, or the best of the cross-play.
    """
    low = next((references[name] for name in LOW if name in references), None)
    best = [] if SELF_PLAY not in references else [references[SELF_PLAY].returns.mean(axis=(0, 2))]
    if crossplay is not None:
        known = [crossplay.best_returns.get(one.partner) for one in partners]
        best += [] if None in known else [np.array(known)]
    if low is None or not best:
        return None
    return Bounds(np.max(best, axis=0), low.returns.mean(axis=(0, 2)))
