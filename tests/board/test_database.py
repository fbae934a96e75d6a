"""Migrations and tables say the same, and a writer is alone."""

import gc
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from assistax_board.store.database import Database
from assistax_board.store.schema import METADATA, submitters


def test_migrations_lead_to_the_tables(tmp_path: Path) -> None:
    database = new_database(tmp_path)
    database.upgrade()  # changes nothing
    with database.read() as connection:
        assert compare_metadata(MigrationContext.configure(connection), METADATA) == []
    with database.write() as connection:  # planted
        connection.execute(sa.text("ALTER TABLE submitters DROP COLUMN contact"))
    with database.read() as connection:
        assert compare_metadata(MigrationContext.configure(connection), METADATA) != []


def test_a_database_of_another_version_is_refused(tmp_path: Path) -> None:
    database = new_database(tmp_path)
    for version in ("0001", "0007"):
        with database.write() as connection:
            known = sa.text("UPDATE alembic_version SET version_num = :version")
            connection.execute(known, {"version": version})
        with pytest.raises(ValueError, match="made by another version of the board"):
            database.upgrade()


def test_a_failed_block_leaves_nothing(tmp_path: Path) -> None:
    database = new_database(tmp_path)
    with pytest.raises(RuntimeError), database.write() as connection:
        add(connection, "lab")
        raise RuntimeError("killed")
    assert count(database) == 0


def test_time_is_read_by_the_only_writer(tmp_path: Path) -> None:
    """Entries of the ledger bear times in their order, however long a writer waits for its turn."""
    database, now, began = new_database(tmp_path), [1.0], threading.Event()
    times: list[float] = []

    def write() -> None:
        began.set()
        with database.begin(lambda: now[0]) as transaction:
            times.append(transaction.now)

    with database.begin(lambda: now[0]):
        waiting = threading.Thread(target=write)
        waiting.start()
        assert began.wait(60)
        time.sleep(0.2)  # until it waits
        now[0] = 2.0
    waiting.join()
    assert times == [2.0]


def test_a_crowd_of_writers_leaves_connections_for_readers(tmp_path: Path) -> None:
    database, begun = new_database(tmp_path), threading.Event()

    def write() -> None:
        begun.set()
        with database.write():
            pass

    with ThreadPoolExecutor(40) as pool, database.write() as connection:
        add(connection, "lab")
        for _ in range(40):  # more than connections
            pool.submit(write)
        begun.wait()
        time.sleep(0.5)  # until they wait
        assert database.engine.pool.status().endswith("Current Checked out connections: 1")
        assert count(database) == 0
    assert count(database) == 1


def test_writers_wait_for_each_other(tmp_path: Path) -> None:
    """Read, then write, by eight threads: with a deferred BEGIN some would fail or lose a row."""
    database = new_database(tmp_path)

    def append(_: int) -> None:
        for _ in range(10):
            with database.write() as connection:
                seen = connection.execute(sa.select(sa.func.count()).select_from(submitters))
                add(connection, f"lab {seen.scalar_one()}")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(append, range(8)))
    assert count(database) == 80


def new_database(folder: Path) -> Database:
    database = Database(f"sqlite:///{folder / 'service.db'}")
    database.upgrade()
    return database


def add(connection: sa.Connection, name: str) -> None:
    connection.execute(sa.insert(submitters).values(id=name, name=name, created_at=0.0))


def count(database: Database) -> int:
    with database.read() as connection:
        query = sa.select(sa.func.count()).select_from(submitters)
        return connection.execute(query).scalar_one()


def test_unreferenced_database_is_closed(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'service.db'}")
    with database.read():
        pass
    pool: Any = database.engine.pool
    assert pool.checkedin() == 1
    del database
    gc.collect()
    assert pool.checkedin() == 0
