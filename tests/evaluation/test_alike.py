"""Jobs of several folders are held against each other, field by field."""

from pathlib import Path
from typing import Any

import pytest

from evaluation.record import manifest
from evaluation.record.alike import (
    check_alike,
    check_members,
    conditions,
    read_identity,
    software_notes,
)

IDENTITY: dict[str, Any] = {
    "task": "gentle_scratch",
    "engine": {"name": "fused", "version": "3"},
    "preferences": ["p1"],
    "stochastic": False,
    "egos": [["mine", "a" * 64]],
    "partners": [["scratch/ippo-d1-s0-v1/human", "d1", "test", "b" * 64, [1.0, 0.5]]],
    "software": {"jax": "0.7.0", "mujoco": "3.3.0"},
}


def other(**changed: Any) -> dict[str, Any]:
    return {name: v for name, v in {**IDENTITY, **changed}.items() if v != "left out"}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"preferences": ["p9"]}, r'preferences is \["p1"\] in a and \["p9"\] in b; play both'),
        ({"preferences": "left out"}, r'preferences is \["p1"\] in a and none in b'),
        ({"stochastic": True}, "stochastic is false in a and true in b"),
        ({"series": 4}, "series is none in a and 4 in b"),
        ({"engine": {"name": "fused", "version": "4"}}, r'engine is \{"name": .* in b'),
    ],
)
def test_other_conditions_are_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_alike({"a": conditions(IDENTITY), "b": conditions(other(**changed))})


def test_policies_and_software_are_no_conditions() -> None:
    others = other(egos=[], partners=[], software={"jax": "0.8.0", "mujoco": "3.3.0"})
    jobs = {"a": IDENTITY, "b": others}
    check_alike({name: conditions(job) for name, job in jobs.items()})


def test_other_software_is_a_note() -> None:
    old, new = {"jax": "0.7.0", "mujoco": "3.3.0"}, {"jax": "0.8.0", "mujoco": "3.3.0"}
    assert software_notes({"a": old, "b": new, "c": old, "d": {}}) == [
        "jax is 0.7.0 in a, 0.8.0 in b, 0.7.0 in c: returns may differ for that alone"
    ]
    assert software_notes({"a": old, "c": old}) == []


def test_only_named_fields_are_compared() -> None:
    jobs = {"a": IDENTITY, "b": other(stochastic=True)}
    check_alike(jobs, ["task", "engine"])
    with pytest.raises(ValueError, match="stochastic is false in a and true in b; ask again"):
        check_alike(jobs, ["task", "stochastic"], advice="ask again")


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (1, "d2", "disability of partner scratch/ippo-d1-s0-v1/human is d1 in a and d2 in b"),
        (2, "train", "side of partner .* is test in a and train in b"),
        (3, "c" * 64, "digest of partner .* is bbb.* in a and ccc.* in b"),
        (4, None, r"setting of partner .* is \[1.0, 0.5\] in a and none in b"),
    ],
)
def test_one_id_is_one_partner(place: int, value: Any, words: str) -> None:
    row = [*IDENTITY["partners"][0]]
    row[place] = value
    stranger = ["scratch/ippo-d1-s1-v1/human", "d1", "test", "d" * 64, None]
    check_members({"a": IDENTITY, "b": other(partners=[stranger])}, "partners")
    with pytest.raises(ValueError, match=words):
        check_members({"a": IDENTITY, "b": other(partners=[stranger, row])}, "partners")


@pytest.mark.parametrize("rows", [None, "mine", [["mine"]], [[1, "a"]], ["mine"]])
def test_strange_members_are_refused(rows: Any) -> None:
    with pytest.raises(ValueError, match="the manifest of b names no egos"):
        check_members({"a": IDENTITY, "b": other(egos=rows)}, "egos")


def test_an_identity_is_that_of_its_job(tmp_path: Path) -> None:
    assert read_identity(tmp_path) is None
    job = manifest.identity_digest(IDENTITY)
    manifest.write_manifest(tmp_path, {"identity": IDENTITY, "job": job})
    assert read_identity(tmp_path) == IDENTITY
    manifest.write_manifest(tmp_path, {"identity": other(seed=1), "job": job})
    with pytest.raises(ValueError, match="names another job than the identity it holds"):
        read_identity(tmp_path)
