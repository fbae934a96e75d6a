"""Where a board lies. Its folder remembers a database and a store of files that lie elsewhere.

So no command can take an empty place for the board, and a board that moved is found by all of them.
"""

import contextlib
import dataclasses
import json
from collections.abc import Generator
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import ArgumentError

from assistax_base.files import OWNER, atomic_write
from assistax_board.store.artefacts import ARTEFACTS_FOLDER
from assistax_board.store.database import DATABASE_FILE
from assistax_board.store.receipts import KEY_FILE

ADDRESSES_FILE = "addresses.json"  # in a data folder; for its owner alone: it may hold a password
EXTRAS = {"psycopg": "postgres", "s3fs": "s3"}  # module -> extra of this distribution
_ALLOWED = "allowed are postgresql://user@host/name and sqlite:///path/of/a/file"


@dataclasses.dataclass(frozen=True)
class Addresses:
    """Where the parts of a board lie."""

    database: sa.URL
    artefacts: str  # a folder, or an address such as s3://bucket/path


def database_url(text: str) -> sa.URL:
    """Return the URL of a database that a user named.

    Raises:
        ValueError: It names none, or one that no board can use.
    """
    try:
        url = sa.make_url(text)
    except ArgumentError:
        raise ValueError(
            f"{text.rpartition('@')[2]!r} is no database's address; {_ALLOWED}"
        ) from None
    kind = url.get_backend_name()
    if kind in ("postgresql", "postgres"):
        return url.set(drivername="postgresql+psycopg")
    if kind != "sqlite" or url.database in (None, "", ":memory:"):
        raise ValueError(f"{url.render_as_string()} is no place for a board; {_ALLOWED}")
    return url.set(database=str(Path(str(url.database)).absolute()))


def are_same(one: sa.URL, other: sa.URL) -> bool:
    """Return whether two URLs are of one database: its password may have changed."""
    return one.set(password="") == other.set(password="")


def addresses_of(
    data: Path, database: str | None = None, artefacts: str | None = None
) -> Addresses:
    """Return where the board of a folder lies; of a new folder, where it is to lie.

    Args:
        data: The folder.
        database: URL that a user names; of a board that is there it must be the folder's.
        artefacts: Address that a user names; so must this.

    Raises:
        ValueError: Another place is named than the folder's, or nobody says where its database is.
    """
    kept, own = _read(data), own_addresses(data)
    place = database_url(kept["database"]) if "database" in kept else own.database
    is_known = "database" in kept or (data / DATABASE_FILE).exists()
    if database is not None:
        named = database_url(database)
        if is_known and not are_same(named, place):
            raise ValueError(
                _another(data, "database", place.render_as_string(), named.render_as_string())
            )
        place = named
    elif not is_known and (data / KEY_FILE).exists():
        raise ValueError(
            f"{data} has the key of a board, but no {DATABASE_FILE} and no address of another "
            "database; start the server once with the database's address, or restore a backup"
        )
    store = kept.get("artefacts", own.artefacts)
    is_known = "artefacts" in kept or (data / ARTEFACTS_FOLDER).exists()
    if artefacts is not None and is_known and artefacts != store:
        raise ValueError(_another(data, "store of files", store, artefacts))
    return Addresses(place, artefacts or store)


def keep_addresses(data: Path, addresses: Addresses) -> None:
    """Let a folder remember what lies outside it; the file changes whole or not at all."""
    path, own = data / ADDRESSES_FILE, own_addresses(data)
    kept = {}
    if addresses.database != own.database:
        kept["database"] = addresses.database.render_as_string(hide_password=False)
    if addresses.artefacts != own.artefacts:
        kept["artefacts"] = addresses.artefacts
    if kept:
        atomic_write(path, f"{json.dumps(kept, indent=2)}\n".encode(), OWNER)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def extras_named() -> Generator[None]:
    """Name the extra to install if its module is missing."""
    try:
        yield
    except ImportError as error:
        for module, extra in EXTRAS.items():
            if module in str(error):
                raise ValueError(
                    f"{module} is not installed; install it with: "
                    f"pip install 'assistax-zoo-board[{extra}]'"
                ) from None
        raise


def own_addresses(data: Path) -> Addresses:
    """Return the places in a folder itself."""
    folder = data.absolute()
    url = sa.URL.create("sqlite", database=str(folder / DATABASE_FILE))
    return Addresses(url, str(folder / ARTEFACTS_FOLDER))


def _read(data: Path) -> dict[str, str]:
    path = data / ADDRESSES_FILE
    if not path.exists():
        return {}
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if not kept.keys() <= {"database", "artefacts"} or not all(map(str.strip, kept.values())):
            raise ValueError
    except (ValueError, AttributeError, TypeError):
        raise ValueError(
            f'{path} is damaged; write {{"database": "postgresql://user@host/name"}} with the '
            "board's own address to it"
        ) from None
    return kept


def _another(data: Path, what: str, kept: str, named: str) -> str:
    return (
        f"the board of {data} has its {what} at {kept}, not at {named}; name no {what}, or a new "
        f"folder. `assistax-zoo service move` moves a database. If the same {what} has a new "
        f"address, write it to {data / ADDRESSES_FILE}"
    )
