"""A service without JAX: a small catalogue, and a scorer that draws returns by hashing."""

import dataclasses
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_base.digest import sha256
from assistax_board.cards import Card
from assistax_board.pages.methods import ZooFiles
from assistax_board.problems import Refusal
from assistax_board.rules import entries, jobs
from assistax_board.rules.catalogue import ZooEntry, version_id
from assistax_board.rules.scoring import Work, encode_table
from assistax_board.rules.submissions import Admitted, Draft
from assistax_board.rules.tokens import authenticate
from assistax_board.service import Service
from assistax_board.store.artefacts import Artefacts
from assistax_board.store.database import Database
from assistax_board.store.receipts import load_signer
from assistax_board.store.shown import Season, Submission

TASK = "scratch"


class FakeCatalogue:
    def __init__(self, partners: int = 60, version: int = 1) -> None:
        self._partners, self._version = partners, version
        self.entries: tuple[ZooEntry, ...] = ()

    @property
    def tasks(self) -> tuple[str, ...]:
        return (TASK,)

    def public_panel(self, task: str) -> tuple[str, ...]:
        return tuple(f"partner-{i:03d}" for i in range(self._partners))

    def references(self, task: str) -> dict[str, str]:
        rows = {"zero-action": "zero-action", "self-play": "self-play"}
        return rows | {name: entry.method for entry in self.entries for name in entry.seeds}

    def published(self, task: str) -> tuple[ZooEntry, ...]:
        return self.entries

    def identity(self, task: str) -> dict[str, Any]:
        return {"task": task, "engine": {"name": "fake", "version": str(self._version)}}


class FakeFiles(ZooFiles):
    """Robots of the zoo by their names, one file each."""

    def __init__(self, files: Mapping[str, bytes] | None = None) -> None:
        self._files = files or {}

    def names(self, task: str) -> dict[str, str]:
        return {sha256(data): name for name, data in self._files.items()}


class FakeScorer:
    """A robot's strength is the number in its file; a partner's return is a hash around it."""

    def __init__(self, version: int = 1) -> None:
        self._version = version

    def versions(self) -> tuple[str, ...]:
        return (version_id(FakeCatalogue(version=self._version).identity(TASK)),)

    def play(self, work: Work, robot: Any, release: bytes | None) -> pl.DataFrame:
        if robot == b"broken":
            raise Refusal("not_finite")
        if work.kind == "reference":
            robot = b"robot 0.0" if work.format == "zero-action" else b"robot 9.0"
        strength = float(robot.decode().split()[1])
        rows = [(name, k) for name in work.partners for k in range(work.episodes)]
        return pl.DataFrame(
            {
                "partner": [name for name, _ in rows],
                "algorithm": ["ippo"] * len(rows),
                "disability": ["d1"] * len(rows),
                "episode": [k for _, k in rows],
                "return": [strength + self.bonus(work, name, k) for name, k in rows],
                "success": [True] * len(rows),
                "nonfinite": [False] * len(rows),
            }
        )

    def bonus(self, work: Work, partner: str, episode: int) -> float:
        return noise(work.seed, partner, episode)


class FakeClock:
    def __init__(self, now: float = 1_700_000_000.0) -> None:
        self.now = now

    def __call__(self) -> float:
        return self.now


def noise(*words: Any) -> float:
    value = int.from_bytes(hashlib.sha256(repr(words).encode()).digest()[:4], "big")
    return float(np.float32(value / 2**32))


def admit(data: bytes, task: str) -> Admitted:
    if not data.startswith((b"robot ", b"broken")):
        raise Refusal("unknown_format")
    return Admitted("fake")


def new_service(folder: Path, url: str | None = None, *, version: int = 1) -> Service:
    folder.mkdir(exist_ok=True)
    database = Database(url or f"sqlite:///{folder / 'service.db'}")
    database.upgrade()
    return Service(
        database,
        Artefacts(str(folder / "artefacts")),
        FakeCatalogue(version=version),
        load_signer(folder),
        admit,
        FakeClock(),
    )


def new_submitter(service: Service, name: str = "lab") -> str:
    token = service.create_token(("submit",), submitter=name)
    submitter = authenticate(service.database, token).submitter
    assert submitter is not None
    return submitter


def draft(strength: float = 1.0, request: str = "r1", **fields: Any) -> Draft:
    data = fields.pop("data", f"robot {strength}".encode())
    method = fields.pop("method", "mine")
    return Draft(task=TASK, method=method, request=request, data=data, **fields)


CARD = Card(1_000_000, "train side of fcp-1", "not published", 3)


def declaration(
    *strengths: float, request: str = "e1", method: str = "mine", **fields: Any
) -> entries.Declaration:
    """Return the declaration of an entry whose robots have these strengths."""
    files = tuple(sha256(f"robot {strength}".encode()) for strength in strengths)
    card = fields.pop("card", dataclasses.replace(CARD, trained=len(files)))
    return entries.Declaration(TASK, method, request, files, card, **fields)


def declared(
    service: Service, submitter: str, *strengths: float, request: str = "e1", **fields: Any
) -> list[str]:
    """Declare an entry of robots of these strengths, hand all in, and return their ids."""
    made = declaration(*strengths, request=request, **fields)
    known = {"method": made.method, "season": made.season}
    known["entry"] = service.declare(submitter, made)
    return [
        service.submit(submitter, draft(strength, f"{request} {strength}", **known))
        for strength in strengths
    ]


def work_off(service: Service, worker: str = "w", version: int = 1, most: int = 1000) -> int:
    """Do what waits, as one worker would, and return how many jobs that was."""
    scorer, done = FakeScorer(version), 0
    while done < most and (work := service.lease(worker, scorer.versions())):
        robot = service.artefacts.get(work.artefact) if work.artefact else None
        try:
            table = scorer.play(work, robot, None)
        except Refusal as refusal:
            service.job_refused(work.job, work.lease, refusal.code)
            continue
        service.result(work.job, work.lease, encode_table(table), 1.0)
        done += 1
    return done


def shown(service: Service, id: str) -> Submission:
    submission = service.queries.submission(id)
    assert submission is not None
    return submission


def take(service: Service, version: int = 1) -> Work:
    work = service.lease("w", FakeScorer(version).versions())
    assert work is not None
    return work


def advance(service: Service, seconds: float) -> None:
    assert isinstance(service.clock, FakeClock)
    service.clock.now += seconds


def fail_next_job(service: Service) -> str:
    """Let the next job fail as often as it may; return its submission."""
    for _ in range(jobs.MAX_FAILURES):
        work = take(service)
        service.job_failed(work.job, work.lease)
    return work.submission


def ends(service: Service, id: str) -> tuple[str, str]:
    """Return the state of a submission, and that of its attempt."""
    submission = shown(service, id)
    return submission.state, submission.attempt


def scored(service: Service, submitter: str, *words: Any, **fields: Any) -> str:
    """Submit a draft of these words and fields, run the waiting jobs, and return its id."""
    id = service.submit(submitter, draft(*words, **fields))
    work_off(service)
    return id


def close_spring(service: Service) -> None:
    """Close the season spring, and run the waiting jobs."""
    service.close_season("spring")
    work_off(service)


def panels_of(service: Service, id: str) -> set[str]:
    """Return the panels on which a submission has a score."""
    return {score.panel for score in service.queries.scores(submission=id)}


def state_of(service: Service, season: str = "spring") -> str:
    """Return the state of a season, given by its name or id."""
    return season_row(service, season).state


def season_row(service: Service, season: str = "spring") -> Season:
    row = service.queries.season(season)
    assert row is not None
    return row
