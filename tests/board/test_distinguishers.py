"""Two seasons that differ in hidden values alone cannot be told apart by who looks from outside.

Their partners, seeds, salts and the return with every single partner differ; what may be shown, one
rounded mean, is the same. Whatever anybody can ask for, the log, and the number of statements to
the database must be the same too, and the time that an answer takes, by a permutation test. Each
test has a leak of its kind planted, which it must find.
"""

import contextlib
import dataclasses
import functools
import itertools
import json
import logging
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa
from sqlalchemy import event
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.pages.cache import PageCache
from assistax_board.rules import results
from assistax_board.rules.scoring import Work, encode_table
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.database import Transaction
from assistax_board.store.queries import Queries
from assistax_board.store.schema import RESULT, SEASON, SUBMISSION
from tests.board.fakes import TASK, FakeScorer, draft, new_service, new_submitter
from tests.board.test_season import SIZE, open_season

# What commits to hidden values without telling them differs, and is made the same before comparing.
COMMITMENTS = re.compile(r'[0-9a-f]{64}|[A-Za-z0-9+/]{86}==|[A-Za-z0-9+/]{43}=|"ms": [0-9.]+')
CLOCKED = re.compile(r"^\w+(_sum|_bucket|_created)\b.*$", re.MULTILINE)


class HiddenScorer(FakeScorer):
    """The returns with hidden partners are dealt among them in another order in each season."""

    def __init__(self, shift: int) -> None:
        super().__init__()
        self._shift = shift

    def bonus(self, work: Work, partner: str, episode: int) -> float:
        if work.panel == "public":
            return super().bonus(work, partner, episode)
        return 0.03 * ((int(partner[-4:]) // 2 + self._shift) % SIZE)


@dataclasses.dataclass
class Season:
    """A service with a season, and what somebody outside has seen of it."""

    service: Service
    http: TestClient
    scorer: HiddenScorer
    seen: list[str] = dataclasses.field(default_factory=list)


def new_season(folder: Path, number: int) -> Season:
    """Return a season; those of two numbers differ in what is hidden."""
    folder.mkdir()
    service = new_service(folder)
    open_season(service, budget=9)
    with service.database.write() as connection:
        [secret] = connection.execute(sa.select(SEASON.secret)).scalars()
        for place, leaf in enumerate(secret["leaves"]):
            leaf["salt"] = f"{number:02d}{place}"
            leaf["policy"] = f"secret-{(place + number) % (2 * SIZE)}"
        secret["leaves"][0]["seeds"] = {"A": f"{number:032x}", "B": f"{number + 5:032x}"}
        release = service.artefacts.put(f"release {number}".encode())
        connection.execute(sa.update(schema.seasons).values(secret=secret, release=release))
    http = TestClient(create_app(service), raise_server_exceptions=False)
    http.app.state.limiter.hit = lambda *_: None  # ty: ignore[missing-attribute]
    return Season(service, http, HiddenScorer(7 * number))


@pytest.fixture
def two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> tuple[Season, Season]:
    """Two seasons whose ids and times are the same."""
    counts: dict[str, Iterator[int]] = {}

    def new_id(length: int = 12) -> str:
        return f"{next(counts[current[0]]):0{length}d}"

    # Kept pages are always too old: which one is shown does not depend on how fast the machine is.
    clock = functools.partial(next, itertools.count(0.0, 1e6))
    monkeypatch.setattr("assistax_board.pages.PageCache", lambda: PageCache(clock))
    current = ["?"]
    for module in ("rules.submissions", "rules.jobs", "rules.tokens", "ids"):
        monkeypatch.setattr(f"assistax_board.{module}.new_id", new_id, raising=False)
    seasons = []
    for number in range(2):
        current[0] = str(number)
        counts[current[0]] = itertools.count()
        seasons.append(new_season(tmp_path / str(number), number))
        live_through(seasons[-1], caplog)
    return seasons[0], seasons[1]


def live_through(season: Season, caplog: pytest.LogCaptureFixture) -> None:
    """Let two robots be scored, look at everything now and then, and keep the log."""
    service = season.service
    lab = new_submitter(service)
    caplog.clear()
    with caplog.at_level(logging.INFO, logger="assistax_board"):
        for number, strength in enumerate((1.0, 1.01)):
            service.submit(lab, draft(strength, f"r{number}", season="season1"))
            while work := service.lease("w", season.scorer.versions()):
                if work.panel == "A" and work.chunk:
                    look(season)
                assert work.artefact is not None
                robot = service.artefacts.get(work.artefact)
                table = encode_table(season.scorer.play(work, robot, None))
                service.result(work.job, work.lease, table, 1.0)
        look(season)
    for record in caplog.records:
        if record.name.startswith("assistax_board"):
            line = f"{record.getMessage()} {json.dumps(vars(record).get('fields'))}"
            season.seen.append(COMMITMENTS.sub("#", line))


def addresses(season: Season) -> list[str]:
    """Return all that can be asked for without a token, and much that cannot."""
    app: Any = season.http.app
    ids = [row.id for row in season.service.queries.submissions()]
    paths = [path for path, methods in app.openapi()["paths"].items() if "get" in methods]
    paths += ["/", f"/tasks/{TASK}", "/ledger", "/seasons", "/seasons/{id}", "/submissions/{id}"]
    paths += [f"/tasks/{TASK}.csv", f"/tasks/{TASK}?sort=m_test&search=mine&show=methods"]
    paths += [f"/tasks/{TASK}/heatmap", "/submissions/{id}/method", "/news.atom"]
    names = [*ids, "season1", "hidden-0001"]
    return sorted(
        {path.replace("{id}", n).replace("{task}", TASK) for path in paths for n in names}
    )


def look(season: Season) -> None:
    """Ask for everything, and keep what came with the work that it was for the database."""
    count = {"statements": 0}

    def before(*_: Any) -> None:
        count["statements"] += 1

    engine = season.service.database.engine
    with contextlib.ExitStack() as stack:
        event.listen(engine, "before_cursor_execute", before)
        stack.callback(event.remove, engine, "before_cursor_execute", before)
        for address in addresses(season):
            count["statements"] = 0
            answer = season.http.get(address)
            left_out = ("etag", "content-length")  # both follow from the body
            headers = sorted((k, v) for k, v in answer.headers.items() if k not in left_out)
            shown_text = CLOCKED.sub("", answer.text) if address == "/metrics" else answer.text
            season.seen.append(
                COMMITMENTS.sub(
                    "#", f"{address} {answer.status_code} {headers} {count} {shown_text}"
                )
            )


def differences(seasons: tuple[Season, Season]) -> list[tuple[str, str]]:
    first, second = (season.seen for season in seasons)
    assert len(first) == len(second) > 100
    return [(a, b) for a, b in zip(first, second, strict=True) if a != b]


@pytest.mark.slow
def test_answers_logs_and_statements_are_the_same(two: tuple[Season, Season]) -> None:
    hidden = [hidden_returns(season.service) for season in two]
    assert sorted(hidden[0]) == sorted(hidden[1])
    assert hidden[0] != hidden[1], "what is hidden differs"
    assert any('"panel":"A"' in line for line in two[0].seen), "a score on panel A is shown"
    assert differences(two) == []


def hidden_returns(service: Service) -> list[float]:
    with service.database.read() as connection:
        first = connection.execute(
            sa.select(SUBMISSION.id, RESULT.version).join(schema.results)
        ).first()
        assert first is not None
        table = results.panel_table(service.artefacts, connection, first.id, first.version, "A")
    return table.sort("partner", "episode")["return"].to_list()


@pytest.mark.slow
@pytest.mark.parametrize("leak", ["body", "log", "statements"])
def test_a_planted_leak_is_found(
    leak: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    # The leak is planted where a panel's end is written.
    real = results._score_panel
    log = logging.getLogger("assistax_board")

    def finish(service: Service, transaction: Transaction, job: Any) -> None:
        real(service, transaction, job)
        if job.panel != "A":
            return
        args = service.artefacts, transaction, job.submission, job.version, "A"
        value = float(results.panel_table(*args).sort("partner")["return"][0])
        if leak == "log":
            log.info("scored", extra={"fields": {"worst": value}})
        if leak == "body":
            update = sa.update(schema.submissions).where(SUBMISSION.id == job.submission)
            transaction.execute(update.values(method=f"mine {value}"))
        if leak == "statements":
            plant_statements(monkeypatch, value)

    monkeypatch.setattr(results, "_score_panel", finish)
    assert differences(request.getfixturevalue("two")) != []


def plant_statements(monkeypatch: pytest.MonkeyPatch, value: float) -> None:
    """Ask the database once more wherever a hidden return is high."""
    real = Queries.season

    def season(self: Queries, id: str) -> Any:
        if value > 1.1:
            real(self, id)
        return real(self, id)

    monkeypatch.setattr(Queries, "season", season)


def times(seasons: tuple[Season, Season], address: str, rounds: int) -> np.ndarray:
    """Return how long an answer takes [N, 2], the two asked in turns in a random order."""
    rng, differences = np.random.default_rng(0), np.empty((rounds, 2))
    for number in range(rounds):
        for which in rng.permutation(2):
            began = time.perf_counter()
            seasons[which].http.get(address)
            differences[number, which] = time.perf_counter() - began
    return differences


def p_value(differences: np.ndarray) -> float:
    """Return how likely so large a difference is if the two are the same: pairs are swapped.

    Of lower quartiles, since what else a machine does only ever adds.
    """
    swapped = np.random.default_rng(1).random((2000, len(differences), 1)) < 0.5
    drawn = np.where(swapped, differences[:, ::-1], differences)  # [2000, N, 2]
    seen, chance = (
        np.abs(np.diff(np.quantile(times, 0.25, axis=-2), axis=-1))
        for times in (differences, drawn)
    )
    return float((1 + (chance >= seen).sum()) / 2001)


ADDRESS = "/api/seasons/season1/attempts"


def told_apart(seasons: tuple[Season, Season]) -> bool:
    """Return whether time tells the two apart thrice in a row: by chance once in a billion."""
    return all(p_value(times(seasons, ADDRESS, 60)) < 0.001 for _ in range(3))


@pytest.mark.slow
def test_answer_times_reveal_no_hidden_value(two: tuple[Season, Season]) -> None:
    assert not told_apart(two)


@pytest.mark.slow
def test_a_planted_leak_of_time_is_found(
    two: tuple[Season, Season], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few milliseconds more or less, by what the first hidden partner was good for."""
    real = Queries.attempts
    values = {id(season.service.database): hidden_returns(season.service)[0] for season in two}
    assert len(set(values.values())) == 2

    def attempts(self: Queries, season: str) -> Any:
        time.sleep(0.05 * (values[id(self.database)] - 1.0))
        return real(self, season)

    monkeypatch.setattr(Queries, "attempts", attempts)
    assert told_apart(two)
