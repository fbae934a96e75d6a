"""Ten thousand damaged registries and shards: one line, and never a byte not published.

What may be loaded is decided here, apart from the code under test: a policy's parameters must have
the sha256 that the undamaged registry records for some policy, under an id whose damaged registry
still names that sha256.
"""

import json
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from assistax_base.digest import sha256
from assistax_base.errors import ZooError
from population.networks.tensors import flatten, parse_stacked, row_sha256
from tests.attack.damage import cut, flip, grow, splice, zero
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry, build_registry, load_registry, parse_registry
from zoo.verify import verify

CASES = 10_000
Damage = Callable[[random.Random, bytes], bytes]


def number(rng: random.Random, data: bytes) -> bytes:
    """Change a digit, which leaves JSON whole."""
    places = [index for index, byte in enumerate(data) if chr(byte).isdigit()]
    place = rng.choice(places)
    return data[:place] + str(rng.randrange(10)).encode() + data[place + 1 :]


def token(rng: random.Random, data: bytes) -> bytes:
    """Replace one value of the JSON by another kind of value."""
    content = json.loads(data)
    node, key = content, rng.choice(list(content))
    while isinstance(node[key], dict | list) and node[key] and rng.random() < 0.8:
        node = node[key]
        key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
    values: list[Any] = [None, True, -1, 2**70, 1.5, 1e308, "", "x", "../../etc/passwd", "\x00\n"]
    values += [[], {}, [[]], {"a": {}}]
    if isinstance(node, dict) and rng.random() < 0.3:
        node[rng.choice(["x", "", "scratch/ippo-d1-s0-v1", "../a"])] = node.pop(key)
    else:
        node[key] = rng.choice(values)
    return json.dumps(content).encode()


BYTES: tuple[Damage, ...] = (flip, cut, grow, splice, zero)


@pytest.fixture
def genuine(registry: Registry) -> dict[str, str]:
    """Row hashes of the undamaged release, recomputed from its bytes."""
    causes: dict[str, str] = {}
    for group in load_stacks(registry, registry.policies):
        leaves = flatten(group.params)
        for row, name in enumerate(group.ids):
            causes[name] = row_sha256({leaf: value[row] for leaf, value in leaves.items()})
    return causes


def one_line(error: ZooError) -> None:
    text = str(error)
    assert text.isprintable() and len(text) < 2000, text
    assert "expected" in text and "found" in text and "next:" in text


def loads_only_what_was_published(registry: Registry, genuine: dict[str, str]) -> int:
    """Load policy by policy; return how many came through."""
    loaded = 0
    for entry in registry.policies:
        try:
            (group,) = load_stacks(registry, [entry])
        except ZooError as error:
            one_line(error)
            continue
        leaves = {name: value[0] for name, value in flatten(group.params).items()}
        assert row_sha256(leaves) == entry.sha256 and entry.sha256 in genuine.values(), entry.id
        assert all(np.isfinite(value).all() for value in leaves.values())
        loaded += 1
    return loaded


def damaged_registries(registry: Registry, genuine: dict[str, str], cases: int) -> tuple[int, int]:
    """Return how many were refused, and how many still loaded."""
    text, refused = registry.path.read_bytes(), 0
    rng = random.Random(7)
    for _ in range(cases):
        data = rng.choice((*BYTES, number, token))(rng, text)
        try:
            damaged = build_registry(
                parse_registry(data.decode("utf-8", errors="replace"), "test"), registry.path
            )
        except ZooError as error:
            one_line(error)
            refused += 1
            continue
        loads_only_what_was_published(damaged, genuine)
    return refused, cases - refused


def damaged_shards(registry: Registry, cases: int) -> int:
    """Return how many were refused: all that differ from what was published."""
    path, rng, refused = registry.shard_path(registry.policies[0].shard), random.Random(8), 0
    whole = path.read_bytes()
    for _ in range(cases):
        data = rng.choice(BYTES)(rng, whole)
        path.write_bytes(data)
        report = verify(registry)
        assert report.ok == (data == whole)
        refused += not report.ok
    path.write_bytes(whole)
    return refused


def forged_shards(registry: Registry, genuine: dict[str, str], cases: int) -> int:
    """Damage shards, and correct size and sha256 in the registry; return how many rows passed."""
    shard = registry.policies[0].shard
    path, rng, passed = registry.shard_path(shard), random.Random(9), 0
    whole = path.read_bytes()
    for _ in range(cases):
        data = rng.choice(BYTES)(rng, whole)
        path.write_bytes(data)
        record = registry.data.shards[shard].model_copy(
            update={"sha256": sha256(data), "bytes": len(data)}
        )
        shards = {**registry.data.shards, shard: record}
        forged = build_registry(registry.data.model_copy(update={"shards": shards}), registry.path)
        passed += loads_only_what_was_published(forged, genuine)
        try:
            parse_stacked(data, "shard")
        except ZooError as error:
            one_line(error)
    path.write_bytes(whole)
    return passed


@pytest.mark.parametrize("cases", [120, pytest.param(CASES, marks=pytest.mark.slow)])
def test_damage_is_refused(registry: Registry, genuine: dict[str, str], cases: int) -> None:
    assert genuine == {entry.id: entry.sha256 for entry in registry.policies}
    refused, loaded = damaged_registries(registry, genuine, cases // 2)
    assert refused > cases // 4 and loaded > 0  # both ways were taken
    assert damaged_shards(registry, cases // 4) > cases // 5
    humans = sum(entry.role == "human" for entry in registry.policies) * (cases // 4)
    assert forged_shards(registry, genuine, cases // 4) >= humans  # the other shard is whole
    assert verify(load_registry(registry.path)).ok


def test_loader_without_row_hashes_is_caught(
    registry: Registry, genuine: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without row hashes the forged shards come through."""
    monkeypatch.setattr(
        "zoo.parameters.storage.row_sha256", lambda leaves: registry.policies[0].sha256
    )
    with pytest.raises(AssertionError):
        forged_shards(registry, genuine, 60)
