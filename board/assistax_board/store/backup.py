"""Backup and restore: the database as it was at one moment, the artefacts, and the signing key."""

import contextlib
import sqlite3
import tempfile
import zipfile
from pathlib import Path

from assistax_board.store.addresses import addresses_of, own_addresses
from assistax_board.store.artefacts import ARTEFACTS_FOLDER
from assistax_board.store.database import DATABASE_FILE
from assistax_board.store.receipts import KEY_FILE


def back_up(data: Path, target: Path) -> int:
    """Write a data folder to one zip while the server runs; return how many artefacts it has.

    The database is copied first: artefacts are never changed and are written before the row that
    names them, so all that the copy names are there. A PostgreSQL database and an object store
    have their own tools; this is for the folder.

    Raises:
        ValueError: The database is damaged, or names artefacts that are not in the folder.
    """
    database = addresses_of(data).database
    if database != own_addresses(data).database:
        place = database.render_as_string()
        raise ValueError(f"the board of {data} is at {place}; use that database's own backup")
    if not (data / DATABASE_FILE).is_file():
        raise ValueError(f"{data} holds no {DATABASE_FILE}; give the folder of a service")
    if target.exists():
        raise ValueError(f"{target} exists; choose another name, a backup replaces nothing")
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        copy = Path(folder) / DATABASE_FILE
        _copy_database(data / DATABASE_FILE, copy)
        _check_named(copy, data / ARTEFACTS_FOLDER)
        whole = Path(folder) / target.name
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
            archive.write(copy, DATABASE_FILE)
            archive.write(data / KEY_FILE, KEY_FILE)
            files = sorted(
                path for path in (data / ARTEFACTS_FOLDER).glob("??/*") if _is_whole(path)
            )
            for path in files:
                archive.write(path, str(path.relative_to(data)))
        whole.chmod(0o600)
        whole.rename(target)
    return len(files)


def restore(source: Path, data: Path) -> None:
    """Write a backup to a folder that is new or empty.

    Raises:
        ValueError: The folder holds something, or the backup is no backup.
    """
    if data.exists() and any(data.iterdir()):
        raise ValueError(f"{data} is not empty; restore to a new folder")
    with zipfile.ZipFile(source) as archive:
        names = set(archive.namelist())
        if not {DATABASE_FILE, KEY_FILE} <= names or archive.testzip() is not None:
            raise ValueError(f"{source} is not a service's backup, or is damaged")
        data.mkdir(parents=True, exist_ok=True)
        data.chmod(0o700)
        for name in sorted(names):
            if not (data / name).resolve().is_relative_to(data.resolve()):
                raise ValueError(f"{source} is not a service's backup")
            archive.extract(name, data)
    (data / KEY_FILE).chmod(0o600)


def _copy_database(source: Path, target: Path) -> None:
    """Copy a database that others write to: SQLite's own way, which sees one moment."""
    with (
        contextlib.closing(sqlite3.connect(source)) as reader,
        contextlib.closing(sqlite3.connect(target)) as writer,
    ):
        try:
            reader.backup(writer)
            integrity = writer.execute("PRAGMA integrity_check(1)").fetchone()[0]
        except sqlite3.DatabaseError as error:
            integrity = str(error)
    if integrity != "ok":
        raise ValueError(
            f"{source} is damaged ({' '.join(integrity.split())}); restore the newest backup to a "
            "new folder, or see `.recover` of SQLite's command line"
        )


def _check_named(database: Path, folder: Path) -> None:
    """Refuse a backup that would lack files named in its database."""
    with contextlib.closing(sqlite3.connect(database)) as connection:
        rows = connection.execute("SELECT sha256 FROM artefacts WHERE erased_at IS NULL")
        names = [name for (name,) in rows]
    missing = [name for name in names if not (folder / name[:2] / name).is_file()]
    if missing:
        raise ValueError(
            f"{len(missing)} of {len(names)} artefacts are not in {folder}, such as {missing[0]}; "
            "if the service keeps them elsewhere, use that store's own backup"
        )


def _is_whole(path: Path) -> bool:
    return path.is_file() and len(path.name) == 64
