"""The same service on a real PostgreSQL, where writers do not wait for each other."""

import dataclasses
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.problems import Problem
from assistax_board.rules.scoring import encode_table
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.database import Database
from assistax_board.store.ledger import check_chain
from assistax_board.store.schema import METADATA
from tests.board.fakes import (
    FakeScorer,
    advance,
    draft,
    fail_next_job,
    new_service,
    new_submitter,
    shown,
    take,
    work_off,
)
from tests.board.running import soon
from tests.board.test_season import open_season
from tests.board.test_submit_form import filled, send

WAITS = sa.text("SELECT count(*) FROM pg_locks WHERE NOT granted")


@pytest.fixture
def service(tmp_path: Path, postgres_url: str) -> Any:
    service = new_service(tmp_path, postgres_url)
    yield service
    service.database.close()


def at_once(count: int, function: Callable[[int], Any]) -> list[Any]:
    """Call a function in threads that start together; return answers and problems."""
    gate = threading.Barrier(count)

    def call(number: int) -> Any:
        gate.wait()
        try:
            return function(number)
        except Problem as problem:
            return problem.code

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(call, range(count)))


def test_migrations_lead_to_the_tables(service: Service) -> None:
    with service.database.read() as connection:
        assert compare_metadata(MigrationContext.configure(connection), METADATA) == []


def test_the_last_attempt_is_taken_once(service: Service) -> None:
    season, submitter = open_season(service, budget=1), new_submitter(service)
    answers = at_once(8, lambda n: service.submit(submitter, draft(1.0, f"r{n}", season=season)))
    assert answers.count("budget_spent") == 7


def test_retry_and_submission_cannot_share_one_attempt(service: Service) -> None:
    season, lab = open_season(service, budget=3), new_submitter(service)
    for number in range(3):
        service.submit(lab, draft(2.0, f"f{number}", season=season))
    failed = [fail_next_job(service) for _ in range(3)]

    def act(number: int) -> Any:
        if number < 3:
            return service.retry(failed[number])
        return service.submit(lab, draft(3.0, f"n{number}", season=season))

    answers = at_once(6, act)
    [attempts] = service.queries.attempts(season)
    assert (attempts.reserved, answers.count("budget_spent")) == (3, 3)


def test_crowds_get_one_submission_and_different_jobs(service: Service) -> None:
    submitter = new_submitter(service)
    assert len(set(at_once(8, lambda _: service.submit(submitter, draft())))) == 1
    for number in range(3):
        service.submit(submitter, draft(request=f"r{number + 2}"))
    versions = FakeScorer().versions()
    works = at_once(12, lambda n: service.lease(f"w{n}", versions))
    assert len({work.job for work in works if work is not None}) == 12


def test_results_that_come_at_once_finish_their_submission(service: Service) -> None:
    """Each of the last two results would think that the other is missing, without a lock."""
    submitter, scorer = new_submitter(service), FakeScorer()
    for number in range(5):
        id = service.submit(submitter, draft(request=f"r{number}"))
        works = [take(service) for _ in range(3)]
        tables = [encode_table(scorer.play(work, b"robot 1.0", None)) for work in works]
        at_once(3, lambda n: service.result(works[n].job, works[n].lease, tables[n], 1.0))  # noqa: B023
        assert shown(service, id).state == "scored"
    entries = service.queries.ledger()
    assert check_chain(entries) == len(entries)


def lab_of(service: Service, id: str) -> str:
    with service.database.read() as connection:
        query = sa.select(schema.submissions.c.submitter).where(schema.submissions.c.id == id)
        return connection.execute(query).scalar_one()


def bring_the_last_result(service: Service, id: str) -> None:
    work = take(service)
    table = encode_table(FakeScorer().play(work, b"robot 1.0", None))
    service.result(work.job, work.lease, table, 1.0)


def close_by_date(service: Service, id: str) -> None:
    advance(service, 91 * 86_400.0)
    assert service.lease("w", ()) is None


@pytest.mark.parametrize(
    "act",
    [
        bring_the_last_result,
        close_by_date,
        lambda service, _: service.close_season("spring"),
        lambda service, _: service.disqualify("spring", "lab"),
        lambda service, id: service.withdraw(id, lab_of(service, id)),
        lambda service, id: service.erase_submitter(lab_of(service, id)),
    ],
    ids=["result", "date", "close", "disqualify", "withdraw", "erase"],
)
def test_submission_and_season_change_do_not_deadlock(
    service: Service, postgres_url: str, act: Callable[[Service, str], None]
) -> None:
    """Each waits for the lock of writers, before it has locked anything else."""
    other = dataclasses.replace(service, database=Database(postgres_url))  # as a command has one
    season, lab = open_season(service), new_submitter(service)
    id = service.submit(lab, draft(2.0, season=season))
    work_off(service, most=4)
    service.submit(lab, draft(1.0, "r2"))  # of no season: its end needs the ledger alone
    with service.database.write() as connection:
        acting = threading.Thread(target=act, args=(other, id))
        acting.start()
        assert soon(lambda: connection.execute(WAITS).scalar())
        connection.execute(sa.text("SELECT 1 FROM seasons FOR KEY SHARE"))  # as an insert does
    acting.join()
    other.database.close()
    entries = service.queries.ledger()
    assert check_chain(entries) == len(entries) > 3


def test_writers_of_two_processes_wait_for_each_other(service: Service, postgres_url: str) -> None:
    other, seen, now = Database(postgres_url), [], [1.0]  # as a command has one
    count = sa.select(sa.func.count()).select_from(schema.submitters)

    def look() -> None:
        with other.begin(lambda: now[0]) as transaction:
            seen.append((transaction.execute(count).scalar_one(), transaction.now))

    looking = threading.Thread(target=look)
    with service.database.write() as connection:
        looking.start()
        assert soon(lambda: connection.execute(WAITS).scalar())
        row = {"id": "lab", "name": "lab", "created_at": 0.0}
        connection.execute(sa.insert(schema.submitters).values(row))
        now[0] = 2.0
    looking.join()
    assert seen == [(1, 2.0)], "the time is read after the lock is held"
    other.close()


def test_a_database_has_one_server(postgres_url: str) -> None:
    first, second = Database(postgres_url), Database(postgres_url)
    with first.only_server(), pytest.raises(ValueError, match="another server runs"):
        second.only_server().__enter__()
    with second.only_server():
        pass


def test_a_nul_in_paths_and_forms_breaks_nothing(service: Service) -> None:
    token = service.create_token(("submit",), submitter="lab")
    with TestClient(create_app(service), raise_server_exceptions=False) as http:
        for path in ("/api/submissions/a%00b", "/submissions/%00/film"):
            assert http.get(path).status_code == 404
        for path in ("/api/boards/scratch?season=%00", "/tasks/scratch?search=x%00"):
            assert http.get(path).status_code == 404
        form = filled(http, token, season="\0", method="mi\0ne")
        assert send(http, form, follow_redirects=False).status_code == 303
    assert [submission.method for submission in service.queries.submissions()] == ["mine"]
