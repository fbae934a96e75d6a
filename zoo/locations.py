"""Places on this machine: the registry in use, the cache, zoos that were added, settings.

    cache     shards/<sha256>.safetensors           whole shards, shared by all registries
              registries/<remote>/registry.json     registries of remotes
              references/, xla/                     reference episodes, compiled programs
    data      added/<namespace>/                    zoos of `assistax-zoo add`
              added/own/                            the user's own zoo, if a command names no place
              splits.json                           the user's splits of official partners
    settings  config.json                           the default remote

The cache may be deleted at any time. Added zoos lie in the user's data folder, because an upgrade
replaces the folder of the registry, which may be read-only too.
"""

import errno
import json
import os
import re
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from assistax_base.digest import sha256
from assistax_base.errors import CacheError
from assistax_base.files import write_json
from assistax_envs.versions import track_of

REGISTRY_VARIABLE = "ASSISTAX_ZOO_REGISTRY"
CACHE_VARIABLE = "ASSISTAX_ZOO_CACHE"
REMOTE_VARIABLE = "ASSISTAX_ZOO_REMOTE"
DATA_VARIABLE = "ASSISTAX_ZOO_DATA"
OWN = "own"  # namespace of the user's own zoo
BUILT_IN_REMOTE: str | None = None  # where a wheel's parameters are published; packagers set it
_PACKAGE = Path(__file__).resolve().parent


def registry_path(path: Path | str | None = None) -> Path:
    """Return the given registry, `$ASSISTAX_ZOO_REGISTRY`, the checkout's, or the wheel's."""
    if path is not None:
        return Path(path)
    if os.environ.get(REGISTRY_VARIABLE):
        return Path(os.environ[REGISTRY_VARIABLE])
    return shipped_registry()


def shipped_registry() -> Path:
    """Return the registry that came with this code: the checkout's, or the wheel's."""
    checkout = _PACKAGE.parent / "registry.json"
    if checkout.is_file() or (_PACKAGE.parent / "pyproject.toml").is_file():
        return checkout
    return _PACKAGE / "registry.json"


def shard_root(path: Path) -> Path:
    """Return the folder of a registry's shard paths: its own, or site-packages for the wheel's."""
    return _PACKAGE.parent if path.resolve() == _PACKAGE / "registry.json" else path.parent


def cache_root() -> Path:
    """Return the cache: `$ASSISTAX_ZOO_CACHE`, or `assistax-zoo` in the user's cache folder."""
    return _user_folder(CACHE_VARIABLE, "XDG_CACHE_HOME", "~/.cache")


def data_root() -> Path:
    """Return where own and added zoos lie: `$ASSISTAX_ZOO_DATA`, or a folder of the user's data."""
    return _user_folder(DATA_VARIABLE, "XDG_DATA_HOME", "~/.local/share")


def cached_shard(digest: str) -> Path:
    """Return where the shard with that sha256 lies if it was fetched."""
    return cache_root() / "shards" / f"{digest}.safetensors"


def packaged_shard(task: str, digest: str) -> Path | None:
    """Return a shard of the installed data package of a task's track; None if it is not there."""
    package = find_spec(data_package(task).replace("-", "_"))
    folders = package.submodule_search_locations if package else None
    paths = (Path(folder, f"{digest}.safetensors") for folder in folders or ())
    return next((path for path in paths if path.is_file()), None)


def data_package(task: str) -> str:
    """Return the name of the data package with the parameters of a task's track."""
    return f"assistax-zoo-{track_of(task).replace('_', '-')}"


def cached_registry(remote: str) -> Path:
    """Return where a remote's registry lies if it was fetched; the name is the user's for it."""
    words = re.sub(r"[^A-Za-z0-9.]+", "-", remote).strip("-.")[-60:]
    digest = sha256(remote.encode())[:8]
    return cache_root() / "registries" / f"{words}-{digest}" / "registry.json"


def added_registry(namespace: str) -> Path:
    """Return where the registry of an added zoo lies."""
    return data_root() / "added" / namespace / "registry.json"


def added_registries() -> dict[str, Path]:
    """Return the registries of all added zoos by namespace, in order."""
    files = sorted((data_root() / "added").glob("[a-z]*/registry.json"))
    return {path.parent.name: path for path in files}


def added_remote(namespace: str) -> str | None:
    """Return where a zoo was added from; None for the user's own zoo."""
    path = added_registry(namespace).with_name("remote")
    return None if namespace == OWN else path.read_text("utf-8")


def own_registry() -> Path:
    """Return where the user's own zoo lies: beside the zoos that were added, as one of them."""
    return added_registry(OWN)


def own_splits_file() -> Path:
    """Return where the user's splits of official partners lie."""
    return data_root() / "splits.json"


def default_remote() -> str | None:
    """Return the remote of `$ASSISTAX_ZOO_REMOTE`, of `config remote`, or of the wheel, if any."""
    return os.environ.get(REMOTE_VARIABLE) or _settings().get("remote") or BUILT_IN_REMOTE


def set_default_remote(remote: str | None) -> None:
    """Save the remote of commands that name no remote; None removes it."""
    kept = {name: value for name, value in _settings().items() if name != "remote"}
    settings = {**kept, **({"remote": remote} if remote else {})}
    write_json(data_root() / "config.json", settings)


@contextmanager
def write_errors(path: Path, size: int) -> Generator[None]:
    """Raise a `CacheError` in place of an OSError of a write to the cache or the data folder."""
    own = path.is_relative_to(data_root())
    what, variable = ("data folder", DATA_VARIABLE) if own else ("cache", CACHE_VARIABLE)
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        raise CacheError(
            f"{what} {path.parent}",
            f"room for {size} bytes" if full else "a folder that can be written",
            f"{error.strerror or error}{_room(path) if full else ''}",
            f"{'free some space' if full else 'allow writing'}, or choose another folder with "
            f"${variable}",
        ) from None


def check_room(folder: Path, size: int) -> None:
    """Check that a folder's disk has room for so many bytes, before anything is reserved for them.

    Raises:
        CacheError: It has not.
    """
    present = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    free = shutil.disk_usage(present).free
    if size > free:
        raise CacheError(
            f"cache {folder}",
            f"room for {size} bytes",
            f"{free} bytes free",
            f"fetch fewer policies, free some space, or choose another folder with "
            f"${CACHE_VARIABLE}",
        )


def _settings() -> dict[str, str]:
    try:
        settings = json.loads((data_root() / "config.json").read_bytes()[:65536])
    except (OSError, ValueError):
        return {}
    pairs = settings.items() if isinstance(settings, dict) else ()
    return {name: value for name, value in pairs if isinstance(value, str)}


def _room(path: Path) -> str:
    try:
        return f" ({shutil.disk_usage(path.parent).free} bytes free)"
    except OSError:
        return ""


def _user_folder(variable: str, base: str, fallback: str) -> Path:
    if os.environ.get(variable):
        return Path(os.environ[variable])
    return Path(os.environ.get(base) or os.path.expanduser(fallback), "assistax-zoo")
