"""A real PostgreSQL, where Debian's `postgresql` is installed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
import sqlalchemy as sa

from assistax_board.pages import behind
from assistax_board.service import Service
from tests.board.fakes import new_service
from tests.board.postgres import Cluster, cluster


@pytest.fixture(scope="session")
def postgres() -> Iterator[sa.URL]:
    """Run a cluster for all tests that leave it alive."""
    with cluster() as running:
        yield running.url


@pytest.fixture(scope="session", autouse=True)
def readers_wait_for_boards() -> Iterator[None]:
    """Let no page be answered before its board is there, however busy the machine is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(behind, "PATIENCE", 120.0)
        yield


@pytest.fixture
def service(tmp_path: Path) -> Service:
    """Make a service of the fakes, whose database is in the test's folder."""
    return new_service(tmp_path)


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Make a client of the pages alone, over a small board."""
    from starlette.testclient import TestClient

    from tests.board.board_data import make_app

    with TestClient(make_app(tmp_path_factory.mktemp("pages"))) as client:
        yield client


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Serve these pages on loopback."""
    from tests.board.board_data import make_app
    from tests.board.running import serving

    with serving(make_app(tmp_path_factory.mktemp("browser"))) as address:
        yield address


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Start a headless browser."""
    from tests.board.browser import browsing

    with browsing() as browser:
        yield browser


@pytest.fixture
def one_window(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop the clock that requests are counted by: in the next minute one more is let in."""
    monkeypatch.setattr("time.time", lambda: 1_800_000_010.0)


@pytest.fixture
def mortal_postgres() -> Iterator[Cluster]:
    """Run a cluster of this test's own, to be killed."""
    with cluster() as running:
        yield running


@pytest.fixture
def postgres_url(postgres: sa.URL) -> Iterator[str]:
    """Make a database for one test."""
    name = f"t{uuid4().hex}"
    engine = sa.create_engine(postgres, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(sa.text(f"CREATE DATABASE {name}"))
    yield postgres.set(database=name).render_as_string(hide_password=False)
    with engine.connect() as connection:
        connection.execute(sa.text(f"DROP DATABASE {name} WITH (FORCE)"))
    engine.dispose()
