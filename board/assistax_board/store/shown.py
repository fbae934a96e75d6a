"""Public views of submissions, scores, seasons and the ledger."""

import dataclasses
from typing import Any

from assistax_board.vocabulary import AttemptState, Kind, SeasonState, SubmissionState


@dataclasses.dataclass(frozen=True)
class Submission:
    """One robot that was handed in."""

    id: str
    submitter: str  # name, or "erased"
    task: str
    method: str  # submissions of one submitter and method are seeds of one method
    kind: Kind
    season: str | None
    state: SubmissionState
    reason: str | None  # word of `vocabulary.REASONS`
    reason_text: str | None
    attempt: AttemptState
    created_at: float
    finished_at: float | None
    artefact: str | None  # sha256 of the file
    licence: str
    place: int | None  # in the queue, 1 is next; None once it ended
    eta_seconds: float | None
    jobs_done: int
    jobs: int
    entered: bool  # chosen for panel B of its season
    about: str | None  # what its submitter says of the method
    link: str | None
    citation: str | None
    warning: str | None  # it was trained in another environment version than it plays
    entry: str | None  # declared entry that it is a seed of; None: a single robot
    declared: int | None  # seeds of that entry
    reference: str | None  # name of a row to measure by, of a published robot the registry's
    card: dict[str, Any] | None  # what its lab says of the entry, see `cards.Card`


@dataclasses.dataclass(frozen=True)
class Score:
    """Released score of a submission on one panel."""

    submission: str
    submitter: str
    task: str
    method: str
    panel: str  # "public", "A" or "B"
    version: str
    figures: dict[str, Any]  # mean, mean_ci, iqm, iqm_ci, n; of A and B as it was released
    created_at: float


@dataclasses.dataclass(frozen=True)
class PartnerScore:
    """Returns of a submission with one public partner."""

    submission: str
    version: str
    partner: str
    algorithm: str
    disability: str
    returns: tuple[float, ...]  # [K]
    successes: int


@dataclasses.dataclass(frozen=True)
class Season:
    """A private release and its rules; nothing secret."""

    id: str
    name: str
    task: str
    state: SeasonState
    budget: int
    rules: str
    root: str | None
    panel_sizes: dict[str, int]
    hidden: dict[str, Any] | None  # how many partners of which kind, in which versions
    opened_at: float | None
    closes_at: float | None  # by itself
    closed_at: float | None


@dataclasses.dataclass(frozen=True)
class Attempts:
    """A submitter's attempts in a season."""

    submitter: str
    spent: int
    reserved: int
    budget: int

    @property
    def left(self) -> int:
        """Number of scored attempts that the submitter has left in the season."""
        return max(0, self.budget - self.spent - self.reserved)


@dataclasses.dataclass(frozen=True)
class SeasonLimit:
    """Limits of a submitter in an open season."""

    id: str
    name: str
    task: str
    closes_at: float | None
    spent: int
    reserved: int  # of submissions that are under way
    budget: int
    left: int
    plays: str  # what is hidden, and in which version it and the public half are played


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of a submitter."""

    file_bytes: int  # that a file may have
    requests_an_hour: int  # with which robots are handed in
    requests_left: int  # now
    seasons: tuple[SeasonLimit, ...]  # that are open, the newest first


@dataclasses.dataclass(frozen=True)
class LedgerEntry:
    """One entry of the ledger; `hash` covers the rest and the entry before."""

    seq: int
    at: float
    kind: str
    body: dict[str, Any]
    previous: str
    hash: str
