"""Where the registry lies, and writes that are seen whole or not at all."""

import contextlib
import hashlib
import os
import secrets
from collections.abc import Generator
from pathlib import Path

from zoo.errors import RegistryError

REGISTRY_VARIABLE = "ASSISTAX_ZOO_REGISTRY"
MAX_REGISTRY_BYTES = 64 * 1024 * 1024
_PACKAGE = Path(__file__).resolve().parent


def registry_path(path: Path | str | None = None) -> Path:
    """Return the registry to use: the given one, `$ASSISTAX_ZOO_REGISTRY`, the checkout's, or the wheel's."""
    if path is not None:
        return Path(path)
    if os.environ.get(REGISTRY_VARIABLE):
        return Path(os.environ[REGISTRY_VARIABLE])
    checkout = _PACKAGE.parent / "registry.json"
    if checkout.is_file() or (_PACKAGE.parent / "pyproject.toml").is_file():
        return checkout
    return _PACKAGE / "registry.json"


def shard_root(path: Path) -> Path:
    """Return the folder that shard paths are relative to: the registry's own, or site-packages for the wheel's."""
    return _PACKAGE.parent if path.resolve() == _PACKAGE / "registry.json" else path.parent


def read_registry_text(path: Path) -> str:
    """Return the registry's text, or say what is wrong with the file.

    Raises:
        RegistryError: The file is missing, unreadable, too large or not UTF-8.
    """
    try:
        if not path.is_file():
            raise FileNotFoundError
        with path.open("rb") as file:
            data = file.read(MAX_REGISTRY_BYTES + 1)
        if len(data) > MAX_REGISTRY_BYTES:
            raise ValueError(f"more than {MAX_REGISTRY_BYTES} bytes")
        return data.decode("utf-8")
    except FileNotFoundError:
        found = "no such file"
    except (OSError, ValueError) as error:
        found = str(error)
    raise RegistryError(
        f"registry {path}",
        expected="a readable registry.json",
        found=found,
        done="nothing was loaded",
        next_step=f"give its path with --registry or ${REGISTRY_VARIABLE}, or restore it from the repository",
    )


def sha256(data: bytes) -> str:
    """Return the hex sha256 of the bytes."""
    return hashlib.sha256(data).hexdigest()


def atomic_write(path: Path, data: bytes) -> None:
    """Write to a temporary sibling, flush it to disk, and rename it over `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    try:
        descriptor = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _flush_folder(path.parent)


def _flush_folder(folder: Path) -> None:
    """Flush the rename itself; where folders cannot be opened (Windows) there is nothing to flush."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def exclusive(folder: Path) -> Generator[None]:
    """Hold a lock on the folder, so that two publications do not overwrite each other; a killed holder lets go."""
    try:
        import fcntl
    except ImportError:  # Windows: one publisher at a time is the user's duty
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
