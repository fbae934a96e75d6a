"""SQLite or PostgreSQL behind one small interface: read, and write as the only writer.

A rule may thus look first and then write, since nothing changes in between. In SQLite `BEGIN
IMMEDIATE` makes a second writer wait instead of failing half way; in PostgreSQL a lock does.
"""

import contextlib
import dataclasses
import threading
import weakref
from collections.abc import Generator
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.exc import OperationalError

from assistax_board.clock import Clock
from assistax_board.store import ledger
from assistax_board.store.shown import LedgerEntry

DATABASE_FILE = "service.db"  # in a data folder, if no URL is given
BUSY_SECONDS = 30  # a writer waits so long for the one before it
WRITER, SERVER = 1, 2  # locks in PostgreSQL
ONE_SERVER = (
    "a board has one server: stop the other one, or name another folder and database; for more "
    "speed start more workers (`assistax-zoo worker`)"
)
MIGRATIONS = Path(__file__).parent / "migrations"


@dataclasses.dataclass(frozen=True)
class Transaction:
    """A transaction of the only writer: its changes happen together or not at all.

    Its entries in the ledger are part of it, and bear its time.
    """

    connection: sa.Connection
    now: float  # seconds since 1970, read once when the transaction began

    def execute(
        self, statement: sa.Executable, rows: Any = None
    ) -> sa.CursorResult[*tuple[Any, ...]]:
        """Run a statement, once for each of `rows` if any are given."""
        return self.connection.execute(statement, rows)

    def insert_once(self, table: sa.Table, row: dict[str, Any]) -> bool:
        """Insert a row unless one of its identity is there; return whether it was inserted."""
        is_sqlite = self.connection.dialect.name == "sqlite"
        insert: Any = sqlite_insert if is_sqlite else postgresql_insert
        statement = insert(table).values(row).on_conflict_do_nothing().returning(sa.literal(1))
        return self.execute(statement).first() is not None

    def record(self, kind: str, body: dict[str, Any]) -> LedgerEntry:
        """Append an entry to the ledger and return it."""
        return ledger.append(self.connection, self.now, kind, body)


# The argument of a function that only reads.
Reader = sa.Connection | Transaction


class Database:
    """A database at the newest schema."""

    def __init__(self, url: str) -> None:
        """Connect; nothing is created, see `upgrade`.

        Args:
            url: Such as "sqlite:///data/service.db" or "postgresql+psycopg://user@host/name".
        """
        self.url = sa.make_url(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        # Writers of this process wait here and not in the database, where each of them would sleep
        # with a connection in hand: thirty of them would leave none for readers.
        self._turn = threading.Lock()
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
        """Bring the schema to the newest version; a new database gets every table.

        Raises:
            ValueError: The database is of a version of the board that this one does not know, or
                does not answer.
        """
        from alembic import command
        from alembic.util import CommandError

        where = self.url.render_as_string()  # without a password
        try:
            command.upgrade(alembic_config(self.url), "head")
        except OperationalError as error:
            reason = str(error.orig).partition("\n")[0]
            raise ValueError(
                f"{where} does not answer ({reason}); correct its address, or let it run"
            ) from None
        except CommandError:
            raise ValueError(
                f"{where} was made by another version of the board, which this one cannot read; "
                "use that version, or name a new folder and database"
            ) from None

    @contextlib.contextmanager
    def read(self) -> Generator[sa.Connection]:
        """Yield a connection that sees one state of the database."""
        with self.engine.connect() as connection:
            yield connection

    @contextlib.contextmanager
    def write(self) -> Generator[sa.Connection]:
        """Yield a connection whose changes are committed together when the block ends."""
        with (
            self._turn,
            self.engine.connect().execution_options(write=True) as connection,
            connection.begin(),
        ):
            if not self.is_sqlite:  # a command is another process
                connection.execute(sa.select(sa.func.pg_advisory_xact_lock(WRITER)))
            yield connection

    @contextlib.contextmanager
    def begin(self, clock: Clock) -> Generator[Transaction]:
        """Yield a transaction of the only writer at the time of `clock`; see `write`."""
        with self.write() as connection:
            yield Transaction(connection, clock())

    @contextlib.contextmanager
    def only_server(self) -> Generator[None]:
        """Keep other servers away from a PostgreSQL database; one of SQLite lies in a folder.

        Raises:
            ValueError: Another server runs on it.
        """
        if self.is_sqlite:
            yield
            return
        # The pool lends its connections to others; this one keeps the lock.
        engine = sa.create_engine(self.url, poolclass=sa.NullPool, isolation_level="AUTOCOMMIT")
        with contextlib.closing(engine.connect()) as connection:
            if not connection.scalar(sa.select(sa.func.pg_try_advisory_lock(SERVER))):
                raise ValueError(f"another server runs on this database; {ONE_SERVER}")
            yield

    def close(self) -> None:
        """Give all connections back."""
        self.engine.dispose()


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
    cursor.execute("PRAGMA journal_mode=WAL")  # readers do not wait for the writer
    cursor.execute("PRAGMA synchronous=FULL")  # what was answered survives a power cut
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.close()


def _begin_sqlite(connection: sa.Connection) -> None:
    write = connection.get_execution_options().get("write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")
