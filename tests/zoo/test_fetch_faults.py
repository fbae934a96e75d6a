"""What can go wrong between a remote and the cache: nothing half-written, and clear errors."""

import contextlib
import dataclasses
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

from assistax_base.errors import CacheError, IntegrityError, RemoteError, ZooError
from tests.zoo.conftest import leftovers, visible, wait_for
from tests.zoo.hub_server import Fault, Hub
from zoo.locations import cached_shard
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry
from zoo.schema import Shard
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import Report, fetch

# The planted defect replaces what a transfer runs.
from zoo.transport.transfer import _Transfer
from zoo.verify import verify

ROOT = Path(__file__).parents[2]
SHARDS = "GET /org/zoo/resolve/.*safetensors"
ROBOT = "GET /org/zoo/resolve/.*robot"


def get(registry: Registry, pattern: str | None = None) -> Report:
    return fetch(registry, registry.select(pattern), open_remote("hf://org/zoo"))


def robots_shard(registry: Registry) -> tuple[Shard, Path]:
    """Return the shard of the robots, and the file of a part of it."""
    shard = registry.data.shards[registry.policies[0].shard]
    return shard, cached_shard(shard.sha256).with_name(f".{shard.sha256}.safetensors.partial")


def refused(
    registry: Registry, cache: Path, kind: type[ZooError], *words: str, pattern: str = "*/robot"
) -> str:
    """Fetch, and hold the error against what every error says."""
    with pytest.raises(kind) as caught:
        get(registry, pattern)
    message = str(caught.value)
    assert all(word in message for word in ("expected ", "found ", "next: ", *words)), message
    assert visible(cache) == []
    return message


@pytest.mark.parametrize(
    "fault",
    [
        Fault(SHARDS, status=429, headers={"Retry-After": "0"}),
        Fault(SHARDS, status=503),
        Fault("GET /api/", status=503),
        Fault(SHARDS, cut=100_000),
        Fault(SHARDS, cut=0),
        Fault(SHARDS, short=100_000),
        Fault(SHARDS, pause=0.01, slice=50_000),
    ],
    ids=["429", "503", "503 on the revision", "truncated", "empty", "short", "slow"],
)
def test_what_passes_is_tried_again(fault: Fault, bare: Registry, hub: Hub) -> None:
    fault.times = 2
    hub.faults = [fault]
    get(bare)
    assert verify(bare).ok and fault.times <= 0


def test_a_long_download_may_break_often(bare: Registry, hub: Hub) -> None:
    hub.faults = [Fault(ROBOT, cut=60_000)]
    report = get(bare, "*/robot")
    assert report.bytes == bare.data.shards[bare.policies[0].shard].bytes
    assert hub.count(ROBOT) > 5


def test_what_arrived_is_gone_on_from(bare: Registry, hub: Hub, cache: Path) -> None:
    hub.faults = [Fault(ROBOT, cut=200_000, times=1), Fault(ROBOT, status=503, times=3)]
    refused(bare, cache, RemoteError, "200000 bytes are kept")
    size = bare.data.shards[bare.policies[0].shard].bytes
    assert get(bare, "*/robot").bytes == size - 200_000
    assert hub.log[-1].endswith("bytes=200000-") and len(visible(cache)) == 1


def test_a_remote_without_ranges_starts_anew(bare: Registry, hub: Hub) -> None:
    hub.faults = [Fault(ROBOT, cut=200_000, times=1), Fault(ROBOT, whole=True)]
    size = bare.data.shards[bare.policies[0].shard].bytes
    assert get(bare, "*/robot").bytes == size + 200_000
    hub.faults = [Fault(SHARDS, cut=200_000, whole=True)]
    with pytest.raises(RemoteError, match="3 times"):
        get(bare)


def test_wrong_bytes_are_thrown_away(bare: Registry, hub: Hub, cache: Path) -> None:
    hub.faults = [Fault(SHARDS, flip=300_000)]
    digest = bare.data.shards[bare.policies[0].shard].sha256
    refused(bare, cache, IntegrityError, f"expected sha256 {digest}", "found sha256", "thrown away")
    assert leftovers(cache) == []


def test_unchecked_fetch_is_caught_on_loading(
    bare: Registry, hub: Hub, cache: Path, monkeypatch
) -> None:
    monkeypatch.setattr(_Transfer, "run", lambda self: self._complete())  # the planted defect
    hub.faults = [Fault(SHARDS, flip=300_000)]
    get(bare)
    assert len(visible(cache)) == 2 and len(verify(bare).problems) == 2
    with pytest.raises(IntegrityError, match="found sha256"):
        load_stacks(bare, bare.policies)


def test_shard_of_wrong_length_is_refused(bare: Registry, hub: Hub, cache: Path) -> None:
    hub.faults = [Fault(SHARDS, longer=b"x")]
    refused(bare, cache, IntegrityError, "found more")
    repository = hub.repositories["org/zoo"]
    for files in repository.commits.values():
        files.update({name: data[:-1] for name, data in files.items() if "robot" in name})
    hub.faults = []
    refused(bare, cache, RemoteError, "status 416")


def test_a_damaged_beginning_is_fetched_anew(bare: Registry, cache: Path) -> None:
    shard, partial = robots_shard(bare)
    partial.parent.mkdir(parents=True)
    for damage in (b"x" * 1000, b"x" * (shard.bytes + 1), b"x" * shard.bytes):
        partial.write_bytes(damage)
        get(bare, "*/robot")
        assert visible(cache) == [f"{shard.sha256}.safetensors"]
        cached_shard(shard.sha256).unlink()


def test_a_missing_shard(bare: Registry, hub: Hub, cache: Path) -> None:
    for files in hub.repositories["org/zoo"].commits.values():
        files.pop(bare.policies[0].shard)
    refused(bare, cache, RemoteError, bare.policies[0].shard, "no such file")


def test_a_hub_that_is_down(bare: Registry, hub: Hub, cache: Path) -> None:
    hub.shutdown()
    hub.server_close()
    refused(bare, cache, RemoteError, "ConnectError", "3 times", "try again later")


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (Fault(SHARDS, status=503), "status 503"),
        (Fault(SHARDS, pause=0.5), "ReadTimeout"),
    ],
)
def test_a_hub_that_stays_busy_or_hangs(
    fault: Fault, reason: str, bare: Registry, hub: Hub, cache: Path, monkeypatch
) -> None:
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 0.1)
    hub.faults = [fault]
    refused(bare, cache, RemoteError, reason, "3 times", "again later")
    assert hub.count(ROBOT) == 3


@pytest.mark.parametrize(
    ("sent", "code"), [(signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)]
)
def test_a_fetch_that_is_killed(
    sent: signal.Signals, code: int, bare: Registry, hub: Hub, cache: Path
) -> None:
    hub.faults = [Fault(ROBOT, pause=0.05, slice=10_000)]
    words = ["fetch", "*/robot", "--from", "hf://org/zoo", "--registry", str(bare.path)]
    environment = {**os.environ, "HF_ENDPOINT": hub.url}
    with subprocess.Popen(
        [sys.executable, "-m", "assistax_zoo", *words], cwd=ROOT, env=environment
    ) as process:
        shard, partial = robots_shard(bare)
        wait_for(lambda: partial.is_file() and partial.stat().st_size >= 20_000)
        process.send_signal(sent)
    assert process.returncode == code
    assert visible(cache) == [] and partial.is_file()
    hub.faults = []
    assert 0 < get(bare, "*/robot").bytes <= shard.bytes - 20_000
    assert visible(cache) == [f"{shard.sha256}.safetensors"] and not partial.exists()


def test_two_fetches_at_once(bare: Registry, hub: Hub, cache: Path) -> None:
    hub.faults = [Fault(SHARDS, pause=0.02, slice=100_000)]
    reports: list[Report] = []
    threads = [threading.Thread(target=lambda: reports.append(get(bare))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert len(reports) == 3 and hub.count(SHARDS) == 2
    size = sum(shard.bytes for shard in bare.data.shards.values())
    assert sum(report.bytes for report in reports) == size
    assert len(visible(cache)) == 2 and not leftovers(cache)


def test_one_failure_stops_the_others(bare: Registry, hub: Hub, cache: Path) -> None:
    hub.faults = [Fault("GET .*human", flip=300_000), Fault(ROBOT, pause=2, slice=20_000)]
    began = time.perf_counter()
    refused(bare, cache, IntegrityError, "human", pattern="*")
    assert time.perf_counter() - began < 40  # the robots' shard alone takes more than 50 s


def test_a_cache_that_cannot_be_a_folder(bare: Registry, cache: Path) -> None:
    cache.write_text("a file")
    refused(bare, cache, CacheError, "ASSISTAX_ZOO_CACHE", "Not a directory")


def test_a_read_only_cache(bare: Registry, cache: Path) -> None:
    with mounted(cache, "ro"):
        refused(bare, cache, CacheError, "Read-only file system", "ASSISTAX_ZOO_CACHE")


def test_a_full_disk(bare: Registry, cache: Path) -> None:
    with mounted(cache, "size=256k"):
        refused(bare, cache, CacheError, "room for", "bytes free", "free some space")
        assert leftovers(cache, "*") == []


@pytest.mark.parametrize("size", [10**15, 10**400])
def test_a_shard_that_says_it_is_huge(bare: Registry, cache: Path, hub: Hub, size: int) -> None:
    huge = {"bytes": size}
    shards = {path: shard.model_copy(update=huge) for path, shard in bare.data.shards.items()}
    data = bare.data.model_copy(update={"shards": shards})
    registry = dataclasses.replace(bare, data=data)

    def on_total(total: int) -> Callable[[int], None]:
        raise AssertionError("the transfer began")

    with pytest.raises(CacheError, match=f"room for {2 * size} bytes, found .* bytes free"):
        fetch(registry, bare.policies, open_remote("hf://org/zoo"), on_total=on_total)
    assert hub.count(SHARDS) == 0 and not leftovers(cache, "*")


def test_a_file_that_may_not_grow(bare: Registry, cache: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, hard))
    try:
        refused(bare, cache, CacheError, "room for", "File too large")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert leftovers(cache, "*") == []
    get(bare)


@contextlib.contextmanager
def mounted(folder: Path, options: str) -> Generator[None]:
    """Mount a small file system in memory, or skip the test where that is not allowed."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("no mount command")
    if done.returncode:
        pytest.skip(f"mounting is not allowed: {done.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
