"""Files by their sha256, in a folder or an object store (any address that fsspec knows)."""

from pathlib import Path
from typing import Any

import fsspec
import sqlalchemy as sa

from assistax_base.digest import sha256
from assistax_base.files import atomic_write
from assistax_board.problems import Problem
from assistax_board.store import schema
from assistax_board.store.database import Transaction
from assistax_board.store.schema import ARTEFACT

ARTEFACTS_FOLDER = "artefacts"  # in a data folder, if no store is named


class Artefacts:
    """Store of immutable bytes by their sha256, which every read checks."""

    def __init__(self, address: str) -> None:
        """Use a folder, or an address such as "s3://bucket/path"."""
        self.address = address
        self._files, self._root = fsspec.core.url_to_fs(address)
        self._is_folder = "file" in self._files.protocol

    def put(self, data: bytes) -> str:
        """Keep bytes and return their sha256; whole bytes that are there are not written again."""
        name = sha256(data)
        try:
            if not self._is_whole(name):
                self._write(name, data)
        except OSError as error:
            # Nothing refers to the file yet, so there is nothing to undo.
            raise Problem("too_full", "the server cannot store files now; try later") from error
        return name

    def get(self, name: str) -> bytes:
        """Return the bytes of this sha256.

        Raises:
            Problem: They are not there, or are damaged.
        """
        try:
            data: Any = self._files.cat_file(self._path(name))
        except FileNotFoundError:
            raise Problem("not_found", f"no artefact {name}") from None
        if sha256(data) != name:
            raise Problem("not_found", f"artefact {name} is damaged; restore it from a backup")
        return data

    def _is_whole(self, name: str) -> bool:
        try:
            return sha256(self._files.cat_file(self._path(name))) == name
        except FileNotFoundError:
            return False

    def erase(self, name: str) -> None:
        """Remove the bytes; their hash stays in the database."""
        path = self._path(name)
        if self._files.exists(path):
            self._files.rm_file(path)

    def _write(self, name: str, data: bytes) -> None:
        if self._is_folder:
            atomic_write(Path(self._path(name)), data)
        else:
            self._files.pipe_file(self._path(name), data)  # an object appears whole or not at all

    def _path(self, name: str) -> str:
        if len(name) != 64 or not set(name) <= set("0123456789abcdef"):
            raise Problem("not_found", "an artefact's name is its sha256")
        return f"{self._root}/{name[:2]}/{name}"


def record_artefact(transaction: Transaction, name: str, size: int) -> None:
    """Note an artefact in the database, once; one that was erased is there again."""
    row = {"sha256": name, "bytes": size, "created_at": transaction.now}
    transaction.insert_once(schema.artefacts, row)
    again = sa.update(schema.artefacts).where(ARTEFACT.sha256 == name)
    transaction.execute(again.where(ARTEFACT.erased_at.is_not(None)).values(erased_at=None))
