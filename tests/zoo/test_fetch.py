import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assistax_base.errors import IntegrityError, OfflineError, RegistryError, RemoteError
from assistax_zoo.shell.main import run
from tests.zoo.conftest import leftovers, visible
from tests.zoo.hub_server import Fault, Hub
from zoo.locations import cached_registry
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry, load_registry
from zoo.transport import remotes
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import Report, fetch, remote_registry
from zoo.transport.remotes import read_file
from zoo.verify import verify

FILES = "GET /org/zoo/resolve/.*safetensors"


def get(name: str | Path, pattern: str | None = None, **arguments: Any) -> tuple[Registry, Report]:
    """Fetch as the command does, and return the registry in the cache as well."""
    remote = open_remote(name)
    registry = remote_registry(remote, lambda changes: True)
    return registry, fetch(registry, registry.select(pattern), remote, **arguments)


def same_parameters(first: Registry, other: Registry, pattern: str = "*") -> bool:
    groups = [load_stacks(registry, registry.select(pattern)) for registry in (first, other)]
    for a, b in zip(*groups, strict=True):
        assert a.ids == b.ids
        assert np.array_equal(a.params["Dense_0"]["kernel"], b.params["Dense_0"]["kernel"])
    return True


@pytest.mark.parametrize("kind", ["folder", "file", "hub", "tag", "web"])
def test_everything_comes_from_every_kind_of_remote(
    kind: str, registry: Registry, cache: Path, hub: Hub
) -> None:
    commit = hub.put("org/zoo", registry.path.parent, tag="v0")
    name = {
        "folder": registry.path.parent,
        "file": registry.path.parent.as_uri(),
        "hub": "hf://org/zoo",
        "tag": "hf://org/zoo@v0",
        "web": f"{hub.url}/org/zoo/resolve/main",
    }[kind]
    fetched, report = get(name)
    assert (report.policies, report.shards, report.present) == (16, 2, 0)
    assert report.bytes == sum(shard.bytes for shard in registry.data.shards.values())
    assert report.revision == (commit if kind in ("hub", "tag") else None)
    assert fetched.path == load_registry(cached_registry(str(name))).path
    assert fetched.path.is_relative_to(cache)
    assert verify(fetched).ok and same_parameters(registry, fetched)
    assert get(name)[1].bytes == 0
    assert not leftovers(cache)


def test_damaged_cache_file_is_fetched_again(registry: Registry, cache: Path) -> None:
    fetched, _ = get(registry.path.parent)
    path = cache / "shards" / min(visible(cache))  # no lock, which lies there too
    path.write_bytes(path.read_bytes()[:-1])
    assert not verify(fetched).ok
    assert get(registry.path.parent)[1].present == 1
    assert verify(fetched).ok


def test_damaged_checkout_file_is_left_to_its_owner(registry: Registry, cache: Path) -> None:
    path = registry.shard_path(registry.policies[0].shard)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(IntegrityError, match="git checkout"):
        fetch(registry, registry.policies, open_remote(registry.path.parent))


def test_offline_uses_what_is_there(registry: Registry, hub: Hub, monkeypatch) -> None:
    from huggingface_hub import constants

    hub.put("org/zoo", registry.path.parent)
    get("hf://org/zoo", "*/human")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    requests = len(hub.log)
    assert get("hf://org/zoo", "*/human")[1].present == 1
    with pytest.raises(OfflineError, match="HF_HUB_OFFLINE"):
        get("hf://org/zoo", "*/robot")
    with pytest.raises(OfflineError, match="fetch once while online"):
        get("hf://org/other")
    assert len(hub.log) == requests


def test_a_growing_remote_is_followed(registry: Registry, hub: Hub, teams, publish_to) -> None:
    hub.put("org/zoo", registry.path.parent)
    get("hf://org/zoo")
    publish_to(teams(seeds=range(6)), registry.path)
    hub.put("org/zoo", registry.path.parent)
    fetched, report = get("hf://org/zoo")
    assert (report.present, report.shards, report.policies) == (2, 4, 24) and verify(fetched).ok


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hf://zoo", "hf://org/name"),
        ("hf://org/zoo/more", "hf://org/name"),
        ("nothing://zoo", "Protocol not known"),
        ("/nowhere/at/all", "no such file"),
        ("hf://org/absent", "no such repository"),
        ("hf://org/data", "expected a model repository, found a dataset"),
        ("hf://org/zoo@v9", r"expected a branch, tag or commit \(v0\), found no revision 'v9'"),
    ],
)
def test_a_wrong_remote_is_named(
    name: str, message: str, registry: Registry, cache: Path, hub: Hub
) -> None:
    hub.put("org/zoo", registry.path.parent, tag="v0")
    hub.put("org/data", registry.path.parent, kind="dataset")
    with pytest.raises(RemoteError, match=message) as caught:
        get(name)
    for word in ("expected", "found", "nothing was fetched", "next: "):
        assert word in str(caught.value)
    assert not cache.exists()


def test_a_remote_without_a_registry_is_refused(
    registry: Registry, cache: Path, hub: Hub, tmp_path: Path
) -> None:
    path = tmp_path / "other" / "registry.json"
    path.parent.mkdir()
    path.with_name("config.json").write_text("{}")
    hub.put("org/other", path.parent)
    with pytest.raises(RemoteError, match=r"expected a zoo with registry\.json in it"):
        get("hf://org/other")
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(RegistryError, match="not a registry"):
        get(path.parent)
    path.write_text(registry.path.read_text().replace('"seed"', '"sead"'))
    with pytest.raises(RegistryError, match=r"unknown field|is missing"):
        get(path.parent)
    assert not cache.exists()


def test_shards_come_in_parallel(
    registry: Registry, hub: Hub, teams, publish_to, monkeypatch
) -> None:
    publish_to(teams(("mappo",)), registry.path)
    hub.put("org/zoo", registry.path.parent)
    together, now = threading.Barrier(4), remotes.HttpRemote.open

    def wait(self, path, start=0):
        if path.endswith(".safetensors"):
            together.wait(timeout=60)
        return now(self, path, start)

    monkeypatch.setattr(remotes.HttpRemote, "open", wait)
    assert get("hf://org/zoo")[1].shards == 4


def test_progress_counts_every_byte_once(large: Registry, hub: Hub) -> None:
    hub.put("org/zoo", large.path.parent)
    hub.faults = [Fault(FILES, cut=200_000, times=3)]
    seen: list[int] = []
    totals: list[int] = []

    def on_total(total: int):
        totals.append(total)
        return seen.append

    _, report = get("hf://org/zoo", on_total=on_total)
    assert sum(seen) == totals[0] == report.bytes


def test_command(registry: Registry, hub: Hub, capsys, monkeypatch) -> None:
    hub.put("org/zoo", registry.path.parent, tag="v0")
    assert run(["fetch", "scratch/*/human", "--from", "hf://org/zoo@v0"]) == 0
    printed = capsys.readouterr()
    for words in ("verified 8 policies in 1 shard", "commit", "--registry"):
        assert words in printed.out
    assert "MB" in printed.err
    assert run(["fetch", "--from", "hf://org/zoo@v9"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", "hf://org/zoo")
    bare = cached_registry("hf://org/zoo@v0")
    assert run(["fetch", "--role", "robot", "--registry", str(bare)]) == 0
    assert run(["verify", "--registry", str(bare)]) == 0


@pytest.mark.parametrize("address", ["hub.example", "https://", "ftp://hub.example", ""])
def test_a_hub_without_a_scheme_is_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "ENDPOINT", address)
    with pytest.raises(RemoteError, match=r"HF_ENDPOINT.*https://hub\.example.*or unset it"):
        open_remote("hf://org/zoo")


@pytest.mark.parametrize("address", ["http:///zoo", "https://"])
def test_address_without_host_is_not_tried_again(address: str) -> None:
    with pytest.raises(RemoteError, match="check the address"):
        read_file(open_remote(address), "registry.json", 100)
