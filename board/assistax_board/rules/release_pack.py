"""A private release as one file: its registry and shards, so that workers fetch it by sha256."""

import io
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from assistax_board.problems import Problem

if TYPE_CHECKING:
    from zoo.registry import Registry
    from zoo.schema import PolicyEntry

REGISTRY_FILE = "registry.json"
MAX_UNPACKED_BYTES = 4 * 1024 * 1024 * 1024
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same release packs to the same bytes


def pack(folder: Path) -> bytes:
    """Return the registry of a folder and the shards that it names, as an uncompressed zip."""
    from zoo.registry import load_registry

    registry = load_registry(folder / REGISTRY_FILE)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in (REGISTRY_FILE, *sorted(registry.data.shards)):
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), (folder / name).read_bytes())
    return buffer.getvalue()


def unpack(data: bytes, folder: Path) -> "Registry":
    """Write a packed release to an empty folder and return its registry.

    Raises:
        Problem: It is damaged, or a name in it leads out of the folder.
    """
    from zoo.registry import load_registry

    root = folder.resolve()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(info.file_size for info in archive.infolist()) > MAX_UNPACKED_BYTES:
                raise Problem("too_large", "the packed release is too large")
            for info in archive.infolist():
                target = (root / info.filename).resolve()
                if not target.is_relative_to(root) or info.is_dir():
                    raise Problem("invalid", "the packed release has a file of a wrong name")
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(archive.read(info))
    except zipfile.BadZipFile:
        raise Problem("invalid", "the packed release is damaged") from None
    return load_registry(folder / REGISTRY_FILE)


def hidden_partners(registry: "Registry", task: str) -> list["PolicyEntry"]:
    """Return the humans of a private release in the order of their ordinals."""
    return sorted(registry.select(task=task, role="human"), key=lambda entry: entry.id)


def ordinal(index: int) -> str:
    """Return the name of a hidden partner: it tells nothing of what it is."""
    return f"hidden-{index:04d}"


def ordinal_index(name: str) -> int:
    """Return the number in an ordinal: the inverse of `ordinal`."""
    return int(name.removeprefix("hidden-"))
