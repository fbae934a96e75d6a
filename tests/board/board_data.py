"""A small database as the service leaves it: methods that were scored, others that wait."""

import dataclasses
import hashlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import sqlalchemy as sa
from fastapi import FastAPI
from starlette.middleware import Middleware

from assistax_board.api.errors import add_error_handlers
from assistax_board.api.rates import Limiter
from assistax_board.pages import add_pages
from assistax_board.pages.security import SecurityHeaders
from assistax_board.store import schema
from assistax_board.store.artefacts import Artefacts
from assistax_board.store.database import Database
from assistax_board.store.queries import Queries
from evaluation.cast.cast import choose_partners
from zoo.registry import load_registry

HOSTILE = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>{{ 7*7 }}"
EPISODES = 8
VERSION = "5" * 64
START = 1_790_000_000.0


@dataclasses.dataclass(frozen=True)
class Robot:
    """A method to be written: its level, and how many seeds it has.

    Several seeds are a declared entry, one is a single robot.
    """

    submitter: str
    method: str
    mean: float
    seeds: int = 1
    spread: float = 6.0


ROBOTS = (
    Robot("reference", "uniform-random", 80.0),
    Robot("reference", "zero-action", 60.0),
    Robot("reference", "self-play", 1010.0),
    Robot("lab", "ppo ego", 987.0, seeds=4),
    Robot("lab", "sac ego", 986.5, seeds=3),
    Robot("school", "scripted", 700.0, seeds=2),
    Robot("group", HOSTILE, 955.0, seeds=2),
)


def make_app(folder: Path, robots: tuple[Robot, ...] = ROBOTS, **options: Any) -> FastAPI:
    """Return an application of pages alone, over a new database."""
    app = FastAPI(docs_url=None, middleware=[Middleware(SecurityHeaders)])
    app.state.limiter = Limiter()
    add_error_handlers(app)
    catalogue = SimpleNamespace(
        tasks=("scratch", "bed_bath", "arm_assist", "gentle_scratch", "gentle_feeding")
    )
    queries = Queries(fill(folder, robots))
    service = SimpleNamespace(
        queries=queries,
        catalogue=catalogue,
        artefacts=Artefacts(str(folder / "artefacts")),
        panel_b=lambda season: [],
    )
    add_pages(app, service, films=folder / "films", **options)
    return app


def fill(folder: Path, robots: tuple[Robot, ...]) -> Database:
    """Return a database with scored robots of scratch, one that waits, and one that was refused."""
    database = Database(f"sqlite:///{folder / 'service.db'}")
    database.upgrade()
    rng = np.random.default_rng(0)
    _, partners = choose_partners(load_registry(), "scratch", None, None)
    ease = rng.normal(0, 5, (len(partners), 1))
    with database.write() as connection:
        write = Writer(connection)
        write.season()
        identity = {"engine": {"name": "native", "version": "3.17"}, "env_version": 1}
        about = {"task": "scratch", "identity": identity, "created_at": START}
        write.add(schema.versions, id=VERSION, **about)
        for robot in robots:
            entry = write.entry(robot) if robot.seeds > 1 else None
            for seed in range(robot.seeds):
                noise = rng.normal(0, robot.spread, (len(partners), EPISODES))
                returns = robot.mean + rng.normal(0, 1) + ease + noise
                write.scored(robot, seed, partners, returns, entry)
        write.submission("lab", "next idea", "queued")
        write.submission("group", HOSTILE, "refused", reason="operator_not_allowed")
    return database


def add_care(folder: Path) -> None:
    """Let the scored robots of a folder's database have played a gentle task."""
    slope = {"slope": 0.5, "slope_ci": None, "within": 0.7}
    care: dict[str, Any] = {"violations": 0.1, "caring_success": 0.55}
    care |= {"failed_persons": 0.4, "discomfort": 0.1}
    care |= {"by_preference": {}, "slopes": {"force": slope, "speed": slope}}
    score = schema.scores.c
    with Database(f"sqlite:///{folder / 'service.db'}").write() as connection:
        for row in connection.execute(sa.select(schema.scores)).all():
            update = sa.update(schema.scores).where(score.submission == row.submission)
            connection.execute(update.values(released=row.released | care))


class Writer:
    """Writes rows as the service would, with ids that are the same in every run."""

    def __init__(self, connection: sa.Connection) -> None:
        self._connection = connection
        self._count = 0
        self._submitters: dict[str, str] = {}

    def add(self, table: sa.Table, **row: Any) -> None:
        self._connection.execute(table.insert(), row)

    def id(self) -> str:
        """Return the next id."""
        self._count += 1
        return hashlib.sha256(str(self._count).encode()).hexdigest()[:16]

    def submitter(self, name: str) -> str:
        """Return a submitter's id, writing it the first time."""
        if name not in self._submitters:
            self._submitters[name] = self.id()
            self.add(schema.submitters, id=self._submitters[name], name=name, created_at=START)
        return self._submitters[name]

    def entry(self, robot: Robot) -> str:
        """Write a frozen entry and return its id."""
        id, owner = self.id(), self.submitter(robot.submitter)
        files = [f"{seed:064x}" for seed in range(robot.seeds)]
        card = {"steps": 1_000_000, "partners": "train side", "code": "none", "trained": 9}
        about = {"task": "scratch", "method": robot.method, "files": files, "card": card}
        times = {"created_at": START, "frozen_at": START}
        self.add(schema.entries, id=id, submitter=owner, request=id, **about, **times)
        return id

    def submission(
        self,
        submitter: str,
        method: str,
        state: str,
        *,
        reason: str | None = None,
        entry: str | None = None,
    ) -> str:
        """Write a submission and return its id."""
        id, owner, request = self.id(), self.submitter(submitter), self.id()
        about: dict[str, Any] = {"task": "scratch", "method": method, "kind": "file"}
        about |= {"licence": "Apache-2.0", "season": None, "state": state, "reason": reason}
        about |= {"attempt": "free", "turn": 0, "entry": entry}
        created = START + self._count
        times = {"created_at": created, "finished_at": None if state == "queued" else created + 60}
        self.add(schema.submissions, id=id, submitter=owner, request=request, **about, **times)
        return id

    def scored(
        self,
        robot: Robot,
        seed: int,
        partners: list[Any],
        returns: np.ndarray,
        entry: str | None = None,
    ) -> str:
        """Write a scored submission with its returns [P, K]."""
        id = self.submission(robot.submitter, robot.method, "scored", entry=entry)
        its = {"submission": id, "version": VERSION}
        for entry, row in zip(partners, returns, strict=True):
            self.add(
                schema.partner_scores,
                **its,
                partner=entry.id,
                algorithm=entry.algorithm,
                disability=entry.disability,
                returns=row.tolist(),
                successes=int((row > 100).sum()),
            )
        mean = float(returns.mean())
        figures = {"mean": mean, "mean_ci": [mean - 1, mean + 1], "n": returns.size}
        shown = {"panel": "public", "figures": figures, "released": figures}
        self.add(schema.scores, **its, **shown, created_at=START + self._count)
        content = {"submission": id, "method": robot.method, "mean": mean, "seed": seed}
        signed = {"content": content, "signature": "0" * 128, "created_at": START}
        self.add(schema.receipts, **its, **signed)
        return id

    def season(self) -> None:
        """Write an open season and its entry in the ledger."""
        name, root = "Spring & <b>sun</b>", "ab" * 32
        about: dict[str, Any] = {"task": "scratch", "state": "open", "budget": 20, "root": root}
        about |= {"rules": "Be fair.\nNo <i>sockpuppets</i>.", "secret": {"seed": "hidden-4711"}}
        about |= {"panel_sizes": {"A": 30, "B": 60}, "created_at": START, "opened_at": START}
        self.add(schema.seasons, id="5ea5011", name=name, **about)
        body = {"season": name, "root": root}
        entry = {"kind": "season_opened", "body": body, "previous": "0" * 64, "hash": "c" * 64}
        self.add(schema.ledger, seq=1, at=START, **entry)
