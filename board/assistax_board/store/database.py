"""SQLite or PostgreSQL behind one small interface: read, write, take rows nobody else takes.

SQLite has one writer at a time; `BEGIN IMMEDIATE` makes a second one wait instead of failing half
way. PostgreSQL has many; rows are taken with `FOR UPDATE SKIP LOCKED`, and what must happen one
after another takes an advisory lock.
"""

import contextlib
import sqlite3
import threading
import time
import weakref
from collections.abc import Generator
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

DATABASE_FILE = "service.db"  # in a data folder, if no URL is given
BUSY_SECONDS = 30  # a writer waits so long for the one before it
MIGRATIONS = Path(__file__).parent / "migrations"


class Database:
    """A database at the newest schema."""

    def __init__(self, url: str) -> None:
        """Connect; nothing is created, see `upgrade`.

        Args:
            url: Such as "sqlite:///data/service.db" or "postgresql+psycopg://user@host/name".
        """
        self.url = sa.make_url(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        # Writers of this process wait here and not in SQLite, which lets each of them sleep with a
        # connection in hand: thirty of them would leave none for readers.
        self._turn = threading.Lock() if self.is_sqlite else contextlib.nullcontext()
        options: dict[str, Any] = (
            {"connect_args": {"timeout": BUSY_SECONDS, "check_same_thread": False}}
            if self.is_sqlite
            else {"pool_pre_ping": True}
        )
        # Parameters may be hidden values, and errors end up in logs.
        self.engine = sa.create_engine(self.url, hide_parameters=True, **options)
        # Whoever lets go of a database closes it: the pool would keep its connections open.
        weakref.finalize(self, self.engine.dispose).atexit = False
        if self.is_sqlite:
            event.listen(self.engine, "connect", _prepare_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)

    def upgrade(self) -> None:
        """Bring the schema to the newest version; a new database gets every table."""
        from alembic import command

        command.upgrade(alembic_config(self.url), "head")

    @contextlib.contextmanager
    def read(self) -> Generator[sa.Connection]:
        """Yield a connection that sees one state of the database."""
        with self.engine.connect() as connection:
            yield connection

    @contextlib.contextmanager
    def write(self) -> Generator[sa.Connection]:
        """Yield a connection whose changes all happen when the block ends, or none of them."""
        with (
            self._turn,
            self.engine.connect().execution_options(write=True) as connection,
            connection.begin(),
        ):
            yield connection

    def take(self, query: sa.Select) -> sa.Select:
        """Return the query with its rows locked, and those left out that another writer holds."""
        return query if self.is_sqlite else query.with_for_update(skip_locked=True)

    def one_at_a_time(self, connection: sa.Connection, what: str) -> None:
        """Let only this transaction do `what` until it ends; in SQLite every writer is alone."""
        if not self.is_sqlite:
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(sa.func.hashtext(what))))

    def close(self) -> None:
        """Give all connections back."""
        self.engine.dispose()


def insert_once(connection: sa.Connection, table: sa.Table, row: dict[str, Any]) -> bool:
    """Insert a row unless one of its identity is there; return whether it was inserted."""
    insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert
    statement = insert(table).values(row).on_conflict_do_nothing().returning(sa.literal(1))
    return connection.execute(statement).first() is not None


def alembic_config(url: sa.URL) -> Any:
    """Return the settings of the migrations for a database."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    config.attributes["url"] = url
    return config


def _prepare_sqlite(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # the driver must not begin transactions on its own
    cursor = connection.cursor()
    _write_ahead(cursor)  # readers do not wait for the writer
    cursor.execute("PRAGMA synchronous=FULL")  # what was answered survives a power cut
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.close()


def _write_ahead(cursor: Any) -> None:
    """Choose the journal: SQLite waits for nobody there, and two servers may begin at once."""
    end = time.monotonic() + BUSY_SECONDS
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
            return
        except sqlite3.OperationalError:
            if time.monotonic() > end:
                raise
            time.sleep(0.05)


def _begin_sqlite(connection: sa.Connection) -> None:
    write = connection.get_execution_options().get("write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")
