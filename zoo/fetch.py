"""Fetching partners: what a selection needs of a remote, in parallel, into the cache."""

import concurrent.futures
import contextlib
import dataclasses
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from zoo.cache import cached_registry, cached_row, cached_shard, refuse_write
from zoo.errors import IntegrityError, OfflineError, RemoteError, ZooError, listing
from zoo.files import MAX_REGISTRY_BYTES, atomic_write, shard_root
from zoo.registry import Registry, build_registry, load_registry, parse_registry
from zoo.remotes import Remote, read_file
from zoo.schema import PolicyEntry
from zoo.slices import NoRangesError, fetch_rows
from zoo.storage import read_row, read_shard, take_row
from zoo.tensors import row_sha256
from zoo.transfer import Item, Stopped, download

REMOTE_VARIABLE = "ASSISTAX_ZOO_REMOTE"
WORKERS = 4  # shards at once

Advance = Callable[[int], None]


@dataclasses.dataclass(frozen=True)
class Report:
    """What a fetch did; everything selected is on this machine, and its hashes are those of the registry."""

    registry: str
    remote: str | None
    revision: str | None  # commit, where the remote has commits
    policies: int
    shards: int  # that the policies are in
    present: int  # of these shards, needed nothing
    sliced: int  # of these shards, only the policies asked for were fetched
    bytes: int  # over the wire
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON-ready values."""
        return dataclasses.asdict(self)


def fetch(
    registry: Registry,
    entries: Iterable[PolicyEntry],
    remote: Remote | None,
    *,
    on_total: Callable[[int], Advance] = lambda total: lambda count: None,
    workers: int = WORKERS,
) -> Report:
    """Make sure that the entries' parameters are on this machine, verified.

    Args:
        registry: Says which bytes; whatever the remote sends is held against it.
        entries: Policies of the registry.
        remote: Where to take missing shards from; None is enough when nothing is missing.
        on_total: Given the number of bytes to come at most; returns what is called as they arrive.
        workers: Shards at once.

    Raises:
        RemoteError: Shards are missing and the remote does not have them, or there is no remote.
        IntegrityError: The remote's bytes are not those of the registry.
        CacheError: The cache cannot take them.
    """
    began = time.perf_counter()
    members: dict[str, list[PolicyEntry]] = {}
    for entry in entries:
        members.setdefault(entry.shard, []).append(entry)
    missing = {
        shard: wanted for shard, wanted in members.items() if not _is_here(registry, shard, wanted)
    }
    received, sliced = 0, 0
    if missing:
        if remote is None:
            raise _no_remote(registry, list(missing))
        advance = on_total(sum(registry.data.shards[shard].bytes for shard in missing))
        received, sliced = _fetch_all(registry, missing, remote, advance, workers)
    return Report(
        registry=str(registry.path),
        remote=remote.name if remote else None,
        revision=remote.revision if remote and missing else None,
        policies=sum(map(len, members.values())),
        shards=len(members),
        present=len(members) - len(missing),
        sliced=sliced,
        bytes=received,
        seconds=round(time.perf_counter() - began, 3),
    )


def remote_registry(remote: Remote) -> Registry:
    """Return a remote's registry, kept in the cache; in offline mode, the one that was kept.

    Raises:
        IntegrityError: It gives another sha256 for a policy that it published before.
        RemoteError: The remote has no registry, or cannot be reached.
        RegistryError: What it has is no registry.
    """
    path = cached_registry(remote.name)
    try:
        content = read_file(remote, "registry.json", MAX_REGISTRY_BYTES)
    except OfflineError:
        if path.is_file():
            return load_registry(path)
        raise
    try:
        text = content.decode()
    except UnicodeDecodeError:
        text = ""  # refused as any other text that is no registry
    data = parse_registry(text, f"registry.json of {remote.name}")
    if path.is_file():
        _refuse_changes(load_registry(path), build_registry(data, path), remote)
    try:
        atomic_write(path, content)
    except OSError as error:
        refuse_write(error, path, len(content))
    return build_registry(data, path)


def _fetch_all(
    registry: Registry,
    missing: Mapping[str, Sequence[PolicyEntry]],
    remote: Remote,
    advance: Advance,
    workers: int,
) -> tuple[int, int]:
    """Return how many bytes came, and of how many shards only some policies."""
    stop, lock = threading.Event(), threading.Lock()

    def count(number: int) -> None:
        with lock:
            advance(number)

    remote.revision  # noqa: B018  asked for once, before the threads
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        tasks = [
            pool.submit(_fetch_shard, registry, shard, wanted, remote, count, stop)
            for shard, wanted in missing.items()
        ]
        try:
            for task in concurrent.futures.as_completed(tasks):
                task.result()
        except BaseException as error:
            stop.set()
            pool.shutdown(cancel_futures=True)
            raise _first(tasks) or error from None
    results = [task.result() for task in tasks]
    return sum(received for received, _ in results), sum(cut for _, cut in results)


def _first(tasks: Sequence[concurrent.futures.Future]) -> BaseException | None:
    """Return the error that stopped the others."""
    errors = [task.exception() for task in tasks if task.done() and not task.cancelled()]
    return next((error for error in errors if isinstance(error, ZooError)), None)


def _fetch_shard(
    registry: Registry,
    path: str,
    entries: Sequence[PolicyEntry],
    remote: Remote,
    advance: Advance,
    stop: threading.Event,
) -> tuple[int, bool]:
    """Return the bytes that came, and whether they were only some of the shard's policies."""
    if stop.is_set():
        raise Stopped
    shard = registry.data.shards[path]
    counted = 0

    def count(number: int) -> None:
        nonlocal counted
        counted += number
        advance(number)

    with contextlib.suppress(NoRangesError):
        received = fetch_rows(remote, path, shard, entries, count)
        if received is not None:
            advance(shard.bytes - counted)
            return received, True
    item = Item(path, cached_shard(shard.sha256), shard.bytes, shard.sha256)
    return download(remote, item, advance, stop), False


def _is_here(registry: Registry, shard: str, entries: Sequence[PolicyEntry]) -> bool:
    """Return whether the policies are on this machine; what is damaged in the cache is removed."""
    cached = cached_shard(registry.data.shards[shard].sha256)
    if registry.shard_path(shard).is_file():
        try:
            read_shard(registry, shard)
            return True
        except ZooError:
            if registry.shard_path(shard) != cached:
                raise
            _remove(cached)
    return all([_is_row_here(entry) for entry in entries])


def _is_row_here(entry: PolicyEntry) -> bool:
    path = cached_row(entry.sha256)
    if not path.is_file():
        return False
    with contextlib.suppress(ZooError):
        if row_sha256(take_row(read_row(entry), 0)) == entry.sha256:
            return True
    _remove(path)
    return False


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        refuse_write(error, path, 0)


def _refuse_changes(old: Registry, new: Registry, remote: Remote) -> None:
    before = {entry.id: entry.sha256 for entry in old.policies}
    changed = [
        entry.id for entry in new.policies if before.get(entry.id, entry.sha256) != entry.sha256
    ]
    if changed:
        raise IntegrityError(
            f"registry.json of {remote.name}",
            expected="the sha256 of what it published before: published bytes never change",
            found=f"another one for {listing(changed)}",
            done="nothing was fetched; the registry of before is kept",
            next_step=f"ask its owner; to believe the new one, delete {old.path}",
        )


def _no_remote(registry: Registry, missing: Sequence[str]) -> RemoteError:
    return RemoteError(
        f"shards of {registry.path}",
        expected=f"all in {shard_root(registry.path)} or in the cache",
        found=f"{len(missing)} missing ({listing(missing, 2)})",
        done="nothing was fetched",
        next_step=f"say where to take them from: --from FOLDER, https://... or hf://org/name, or ${REMOTE_VARIABLE}",
    )
