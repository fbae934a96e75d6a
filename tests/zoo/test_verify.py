from pathlib import Path
from typing import Any

import pytest

from assistax_base.digest import sha256
from population.networks.tensors import take_row
from tests.zoo.conftest import edited
from zoo.parameters.encoding import encode_shard
from zoo.parameters.storage import read_shard
from zoo.registry import Registry
from zoo.verify import verify


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)


def test_all_damage_is_reported_at_once(registry: Registry) -> None:
    robot, human = (registry.shard_path(entry.shard) for entry in registry.policies[:2])
    flip(robot)
    human.unlink()
    report = verify(registry)
    assert not report.ok and len(report.problems) == 2
    assert "found sha256" in "".join(report.problems) and "no file at" in "".join(report.problems)


def test_rows_are_held_against_the_registry(registry: Registry) -> None:
    entry, other = registry.policies[0], registry.policies[2]

    def swap(data: dict[str, Any]) -> None:
        first, two = (data["teams"][team]["policies"]["robot"] for team in (entry.team, other.team))
        first["row"], two["row"] = two["row"], first["row"]

    problems = "\n".join(verify(edited(registry, swap)).problems)
    assert f"parameters of {entry.id}: expected sha256 {entry.sha256}" in problems
    assert "records" in problems


def test_rewritten_shard_is_caught_by_row_hashes(registry: Registry) -> None:
    """A forger who also corrects the shard's own size and hash in the registry."""
    entry = registry.policies[0]
    stacked = read_shard(registry, entry.shard)
    rows = [(item["id"], {**take_row(stacked, n)}) for n, item in enumerate(stacked.rows)]
    rows[0][1]["log_std"] = rows[0][1]["log_std"] + 1
    data, _ = encode_shard(stacked.spec, rows)
    registry.shard_path(entry.shard).write_bytes(data)
    forged = edited(
        registry, lambda d: d["shards"][entry.shard].update(sha256=sha256(data), bytes=len(data))
    )
    problems = verify(forged).problems
    assert len(problems) == 3 and entry.id in problems[1]
    assert "release v0: expected root" in problems[0]


def test_duplicates_and_lost_rows_are_found(registry: Registry) -> None:
    first, two = registry.policies[0], registry.policies[2]

    def point(data: dict[str, Any]) -> None:
        robot = data["teams"][first.team]["policies"]["robot"]
        data["teams"][two.team]["policies"]["robot"] = robot

    problems = "\n".join(verify(edited(registry, point)).problems)
    assert f"{two.id} has the same parameters as {first.id}" in problems
    assert "rows are not one policy each" in problems


def test_changed_splits_and_settings_are_found(registry: Registry) -> None:
    def change(data: dict[str, Any]) -> None:
        data["splits"][0]["seed"] = 1
        data["disability_settings"]["d9"]["strength"] = 0.5

    problems = "\n".join(verify(edited(registry, change)).problems)
    assert "expected sha256" in problems and "disability settings" in problems


def test_another_environment_version_is_a_note(
    registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zoo.verify.VERSIONS", {"scratch": 2})
    report = verify(registry)
    assert report.ok and "scratch version 1; installed is 2" in report.notes[0]
