"""Fetch the shards of a selection of partners from a remote, in parallel, into the cache."""

import dataclasses
import threading
import time
from collections.abc import Callable, Iterable, Sequence

from assistax_base.errors import IntegrityError, OfflineError, RemoteError, ZooError, listing
from assistax_base.files import atomic_write, remove_stale
from assistax_base.parallel import run_all
from assistax_envs.versions import OURS
from zoo.history.merkle import root_problems
from zoo.locations import (
    REMOTE_VARIABLE,
    added_remote,
    cache_root,
    cached_registry,
    cached_shard,
    check_room,
    data_package,
    shard_root,
    write_errors,
)
from zoo.namespaces import plain_name, split_namespace
from zoo.parameters.storage import read_shard
from zoo.registry import (
    MAX_REGISTRY_BYTES,
    Registry,
    build_registry,
    load_registry,
    parse_registry,
)
from zoo.schema import PolicyEntry
from zoo.transport.addresses import open_remote
from zoo.transport.remotes import Remote, read_file
from zoo.transport.transfer import Item, download
from zoo.transport.updates import Accept, check_update, take_none

WORKERS = 4  # shards at once
PARTIAL_SECONDS = 7 * 24 * 3600.0  # after which a partial file is not gone on from, but removed

Advance = Callable[[int], None]
OnTotal = Callable[[int], Advance]


@dataclasses.dataclass(frozen=True)
class Report:
    """Report of a fetch, after which all selected policies are here with the registry's hashes."""

    registry: str
    remote: str | None
    revision: str | None  # commit, where the remote has commits
    policies: int
    shards: int  # that the policies are in
    present: int  # of these shards, needed nothing
    bytes: int  # over the wire
    seconds: float


def fetch(
    registry: Registry,
    entries: Iterable[PolicyEntry],
    remote: Remote | None = None,
    *,
    on_total: OnTotal = lambda total: lambda count: None,
) -> Report:
    """Make sure that the entries' parameters are on this machine, verified.

    Args:
        registry: Has the hashes, with which received bytes are compared.
        entries: Policies of the registry; those of an added zoo come from where it was added from.
        remote: Where to take missing shards from; None is enough when nothing is missing.
        on_total: Called with the most bytes to come; returns a function that is called with numbers
            of received bytes.

    Raises:
        RemoteError: Shards are missing and the remote does not have them, or there is no remote.
        IntegrityError: The remote's bytes are not those of the registry.
        CacheError: The cache cannot take them, or has no room for as many bytes as they say.
    """
    began = time.perf_counter()
    policies: dict[str, list[PolicyEntry]] = {}
    for entry in filter(_has_bytes, entries):
        policies.setdefault(split_namespace(entry.shard)[0], []).append(entry)
    sources = []
    # Shards, present shards, bytes.
    counts = [0, 0, 0]
    for namespace, members in policies.items():
        source = _source(namespace, remote)
        shards = list(dict.fromkeys(plain_name(entry.shard) for entry in members))
        sources += [source.name] if source else []
        fetched = _fetch_part(registry.part(namespace), shards, source, on_total)
        counts = [before + now for before, now in zip(counts, fetched, strict=True)]
    return Report(
        registry=str(registry.path),
        remote=", ".join(sources) or None,
        revision=remote.revision if remote and counts[0] > counts[1] else None,
        policies=sum(map(len, policies.values())),
        shards=counts[0],
        present=counts[1],
        bytes=counts[2],
        seconds=round(time.perf_counter() - began, 3),
    )


def check_local(registry: Registry, entries: Iterable[PolicyEntry]) -> None:
    """Check that parameters are here before anything is loaded.

    Raises:
        RemoteError: Some are missing.
    """
    entries = list(filter(_has_bytes, entries))
    shards = [entry.shard for entry in entries]
    missing = {shard for shard in shards if not registry.shard_path(shard).is_file()}
    if missing:
        tasks = {entry.task for entry in entries if entry.shard in missing}
        packages = sorted({data_package(task) for task in tasks if task in OURS})
        pip = f"`pip install {' '.join(packages)}` brings them, or " if packages else ""
        raise RemoteError(
            f"parameters of {sum(shard in missing for shard in shards)} of {len(shards)} policies",
            "all on this machine",
            f"{len(missing)} shards missing ({listing(sorted(missing), 2)})",
            f"{pip}fetch them before, by `assistax-zoo fetch` or `assistax_zoo.fetch`",
            "nothing was loaded",
            remedy="fetch before",
        )


def _has_bytes(entry: PolicyEntry) -> bool:
    return bool(entry.shard)


def remote_registry(remote: Remote, accept: Accept = take_none) -> Registry:
    """Return a remote's registry, kept in the cache; in offline mode, the one that was kept.

    Args:
        remote: Where it is.
        accept: See `zoo.transport.updates.check_update`.

    Raises:
        IntegrityError: It lost or changed something that it published before, or its content
            differs from its roots.
        UpdateError: It changed a default of its users, and the change was not accepted.
        RemoteError: The remote has no registry, or cannot be reached.
        RegistryError: Its registry is malformed.
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
    registry = build_registry(parse_registry(text, f"registry.json of {remote.name}"), path)
    if problems := root_problems(registry.data):
        kept = "nothing was fetched; the registry of before is kept"
        where = f"registry.json of {remote.name}"
        expected = "content of its own roots"
        raise IntegrityError(where, expected, problems[0], "ask its owner", kept)
    if path.is_file():
        check_update(load_registry(path), registry, remote.name, accept)
    with write_errors(path, len(content)):
        atomic_write(path, content)
    return registry


def _source(namespace: str, remote: Remote | None) -> Remote | None:
    """Return where parameters of a zoo come from; the user's own are nowhere else."""
    name = added_remote(namespace) if namespace else None
    return open_remote(name) if name else None if namespace else remote


def _fetch_part(
    registry: Registry,
    shards: Sequence[str],
    remote: Remote | None,
    on_total: OnTotal,
) -> tuple[int, int, int]:
    """Return how many shards of one zoo were asked for, how many were here, and the bytes."""
    missing = [shard for shard in shards if not _is_here(registry, shard)]
    if not missing:
        return len(shards), len(shards), 0
    if remote is None:
        raise _no_remote(registry, missing)
    source = remote
    sizes = {shard: registry.data.shards[shard].bytes for shard in missing}
    check_room(cache_root(), sum(sizes.values()))
    advance = on_total(sum(sizes.values()))
    lock = threading.Lock()

    def count(number: int) -> None:
        with lock:
            advance(number)

    def work(shard: str) -> Callable[[threading.Event], int]:
        entry = registry.data.shards[shard]
        item = Item(shard, cached_shard(entry.sha256), entry.bytes, entry.sha256)
        return lambda stop: download(source, item, count, stop)

    remove_stale(cache_root() / "shards", ".*.partial", PARTIAL_SECONDS)
    remote.revision  # noqa: B018  asked for once, before the threads
    works = [work(shard) for shard in missing]
    received = run_all(works, WORKERS, sum(sizes.values()), remote.name)
    return len(shards), len(shards) - len(missing), sum(received)


def _is_here(registry: Registry, shard: str) -> bool:
    """Return whether a shard is on this machine; a damaged file in the cache is removed."""
    path = registry.shard_path(shard)
    if not path.is_file():
        return False
    try:
        read_shard(registry, shard)
        return True
    except ZooError:
        if path != cached_shard(registry.data.shards[shard].sha256):
            raise
    with write_errors(path, 0):
        path.unlink(missing_ok=True)
    return False


def _no_remote(registry: Registry, missing: Sequence[str]) -> RemoteError:
    return RemoteError(
        f"shards of {registry.path}",
        f"all in {shard_root(registry.path)} or in the cache",
        f"{len(missing)} missing ({listing(missing, 2)})",
        "say where to take them from: a folder, https://... or hf://org/name, also by "
        f"`assistax-zoo config remote` or ${REMOTE_VARIABLE}",
        remedy="name a remote",
    )
