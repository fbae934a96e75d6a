"""From released scores to the board of a task.

A board is computed behind its readers, who meanwhile see the one before. A new score costs the
figures of its own method, and the places: the figures of other methods are kept.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from assistax_base.digest import json_sha256
from assistax_board.pages.behind import Behind
from assistax_board.pages.crossplays import CrossPlay, CrossPlays
from assistax_board.pages.methods import Played, ZooFiles, digest_of, find_copies, group_methods
from assistax_board.places.boards import BoardRow, Method, Panel, board_rows, unplaced
from assistax_board.places.caring import mean_care
from assistax_board.store.queries import Queries
from assistax_board.store.shown import PartnerScore, Score, Submission
from assistax_envs.persons.rows import groups_of
from evaluation.figures.metrics import SEED_SDS, Bounds
from evaluation.figures.normalised import RANDOM, SELF_PLAY, ZERO

LOW = (RANDOM, ZERO)  # references that earn a normalised return of 0, the first there is
Care = Mapping[str, Mapping[str, float]]  # figures of `mean_care` by row's name
_AT_ONCE = 200  # submissions whose returns are read together
_NEWEST = 100_000  # submissions of a board; all of them


@dataclasses.dataclass(frozen=True, eq=False)
class Board:
    """All methods of a task, under one version of everything that decides a score."""

    task: str
    version: str
    identity: Mapping[str, Any]
    partners: tuple[PartnerScore, ...]  # one of each partner, for its name and traits
    rows: tuple[tuple[BoardRow, Played], ...]  # the highest M_test first
    care: Care  # of a gentle task; else empty

    @property
    def groups(self) -> tuple[str, ...] | None:
        """The group of each partner [P], see `groups_of`; None without groups."""
        return groups_of([partner.algorithm for partner in self.partners])

    @property
    def episodes(self) -> int:
        """Number of episodes with each partner."""
        return self.rows[0][1].returns.shape[2]

    @property
    def methods(self) -> tuple[tuple[BoardRow, Played], ...]:
        """The declared entries, the highest M_test first."""
        return tuple(row for row in self.rows if row[1].is_entry)

    @property
    def published(self) -> tuple[tuple[BoardRow, Played], ...]:
        """The declared entries of the zoo, the highest M_test first; they take no place."""
        return tuple(row for row in self.rows if row[1].is_published)

    @property
    def singles(self) -> tuple[tuple[BoardRow, Played], ...]:
        """The robots that no entry declared, the highest M_test first; they take no place."""
        return tuple(row for row in self.rows if row[1].is_single)

    def of(self, submission: str) -> tuple[BoardRow, Played] | None:
        """Return the row that a submission is a seed of."""
        for standing, played in self.rows:
            if any(seed.id == submission for seed in played.submissions):
                return standing, played
        return None


class Boards:
    """The boards of all tasks, each kept until a submission to it is scored or taken back."""

    def __init__(self, queries: Queries, crossplays: CrossPlays, zoo_files: ZooFiles) -> None:
        self._queries, self._crossplays, self._zoo_files = queries, crossplays, zoo_files
        self._boards: Behind[Board | None] = Behind()
        self._caches: dict[str, _ReturnsCache] = {}

    def of(self, task: str, version: str | None = None) -> Board | None:
        """Return the board of a task under a version, or None while it is empty.

        Who asks waits a moment for a new one, then gets the board as it was before the last score.
        Without a version it is the one that is served.
        """
        versions = self._queries.versions(task)
        chosen = next((row for row in versions if version in (None, row[0])), None)
        if chosen is None:
            return None
        people = self._queries.people(task) or {}
        stamp = self._queries.board_stamp(chosen[0]), json_sha256(people)
        return self._boards.value(
            _name(task, version),
            (chosen[0], stamp),
            lambda: self._board(task, self._scored(task, *chosen), people, version is None),
        )

    def is_behind(self, task: str, version: str | None = None) -> bool:
        """Return whether scores are there that the board does not show yet."""
        return self._boards.is_behind(_name(task, version))

    def _scored(self, task: str, version: str, identity: Mapping[str, Any]) -> "_Scored":
        """Return all submissions that count on the board of a version."""
        every = self._queries.submissions(task=task, limit=_NEWEST)
        # Other versions' scores change nothing; after an upgrade this one's come one by one.
        scores = self._queries.scores(task=task, panel="public", version=version)
        under_it = {score.submission for score in scores}
        scored = [row for row in every if row.state == "scored" and row.id in under_it]
        return _Scored(version, identity, tuple(scored), scores)

    def _board(
        self, task: str, scored: "_Scored", people: Mapping[str, Any], is_served: bool
    ) -> Board | None:
        # What other boards read is not kept: they hardly change.
        cache = self._caches.setdefault(task, _ReturnsCache()) if is_served else _ReturnsCache()
        cache.update(self._queries, scored)
        methods = cache.methods(scored.submissions, self._zoo_files)
        if not methods:
            return None
        partners = cache.panel()
        references = {
            method.newest.method: method.returns for method in methods if method.is_reference
        }
        panel = Panel(
            tuple(partner.disability for partner in partners),
            bounds_of(
                [partner.partner for partner in partners], references, self._crossplays.of(task)
            ),
            groups_of([partner.algorithm for partner in partners]),
            SEED_SDS.get(task),
            sum(method.is_entry and not method.is_whole for method in methods),
        )
        by_name = {method.newest.id: method for method in methods}
        named = tuple((row, by_name[row.name]) for row in cache.rows(by_name, panel))
        care = _care_of(named, scored.scores)
        if people and people.get("env_version") == scored.identity["env_version"]:
            care = _with_people(care, named, people["methods"])
        return Board(task, scored.version, scored.identity, partners, named, care)


def _care_of(rows: Sequence[tuple[BoardRow, Played]], scores: Sequence[Score]) -> Care:
    """Return how people fared with each row of a gentle task; nothing of another task."""
    figures = {score.submission: score.figures for score in scores if "violations" in score.figures}
    care = {}
    for standing, played in rows:
        seeds = [figures[seed.id] for seed in played.submissions if seed.id in figures]
        if seeds:
            care[standing.name] = mean_care(seeds)
    return care


def _with_people(
    care: Care, rows: Sequence[tuple[BoardRow, Played]], accepted: Mapping[str, Mapping[str, Any]]
) -> Care:
    """Return the figures of care with caring success with people, of rows that people met.

    People play published robots and scripts, which are rows to measure by.
    """
    found = {name: dict(figures) for name, figures in care.items()}
    for standing, played in rows:
        if played.is_reference and (mine := accepted.get(played.newest.method)):
            found.setdefault(standing.name, {})["with_people"] = float(mine["caring_success"])
    return found


def _name(task: str, version: str | None) -> str:
    return task if version is None else f"{task} {version}"


@dataclasses.dataclass(frozen=True)
class _Scored:
    """Version and submissions of a board."""

    version: str
    identity: Mapping[str, Any]
    submissions: tuple[Submission, ...]
    scores: Sequence[Score]  # on the public panel


class _ReturnsCache:
    """Returns and rows of submissions under one version; of one thread at a time."""

    def __init__(self) -> None:
        self._version = ""
        self._partners: dict[str, PartnerScore] = {}
        # Of each submission its partners, in order, and returns [P, K].
        self._returns: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
        self._digests: dict[str, str] = {}  # of each submission's returns
        self._rows: dict[str, BoardRow] = {}  # by a hash of all that a row follows from

    def update(self, queries: Queries, scored: _Scored) -> None:
        """Read the returns of new submissions, and delete those of submissions that are gone."""
        if scored.version != self._version:
            self.__init__()
            self._version = scored.version
        ids = [row.id for row in scored.submissions]
        for gone in self._returns.keys() - set(ids):
            del self._returns[gone]
        new = [id for id in ids if id not in self._returns]
        for start in range(0, len(new), _AT_ONCE):
            scores = queries.partner_scores(new[start : start + _AT_ONCE], scored.version)
            for id, group in itertools.groupby(scores, key=lambda score: score.submission):
                rows = sorted(group, key=lambda score: score.partner)
                self._partners |= {row.partner: row for row in rows}
                names = tuple(row.partner for row in rows)
                self._returns[id] = names, np.array([row.returns for row in rows])
                self._digests[id] = digest_of(self._returns[id][1])

    def panel(self) -> tuple[PartnerScore, ...]:
        """Return one score of each partner that any submission met, in order of names."""
        return tuple(self._partners[name] for name in sorted(self._partners))

    def methods(self, submissions: Sequence[Submission], zoo_files: ZooFiles) -> list[Played]:
        """Put the seeds of each entry together, and the single robots of one lab and name.

        A submission without a score from the whole panel is left out: it has yet to be scored under
        this version.
        """
        partners = tuple(score.partner for score in self.panel())
        groups = group_methods(
            seed
            for seed in submissions
            if partners and self._returns.get(seed.id, ((),))[0] == partners
        )
        copies = find_copies(groups, self._digests, zoo_files)
        return [
            Played(
                tuple(group),
                np.stack([self._returns[seed.id][1] for seed in group]),
                copies.get(group[-1].id),
            )
            for group in groups
        ]

    def rows(self, methods: Mapping[str, Played], panel: Panel) -> tuple[BoardRow, ...]:
        """Return the rows of a board; only changed ones are computed anew."""
        bounds = panel.bounds and [panel.bounds.best.tolist(), panel.bounds.low.tolist()]
        before, self._rows = self._rows, {}

        def figures(method: Method, panel: Panel) -> BoardRow:
            seeds = [seed.id for seed in methods[method.name].submissions]
            key = json_sha256([seeds, panel.disabilities, panel.groups, bounds])
            self._rows[key] = before.get(key) or unplaced(method, panel)
            return self._rows[key]

        played = [Method(name, method.returns, method.competes) for name, method in methods.items()]
        return board_rows(played, panel, figures)


def bounds_of(
    partners: Sequence[str], references: Mapping[str, np.ndarray], crossplay: CrossPlay | None
) -> Bounds | None:
    """Return the returns of a random robot and of the best known robot with each partner.

    That is its own robot, or the best of the cross-play. `references` are returns [S, P, K].
    """
    low = next((references[name] for name in LOW if name in references), None)
    best = [] if SELF_PLAY not in references else [references[SELF_PLAY].mean(axis=(0, 2))]
    if crossplay is not None:
        known = [crossplay.best_returns.get(name) for name in partners]
        best += [] if None in known else [np.array(known)]
    return None if low is None or not best else Bounds(np.max(best, 0), low.mean(axis=(0, 2)))
