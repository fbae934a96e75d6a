"""Jobs of several folders are held against each other, field by field."""

from typing import Any

import pytest

from evaluation.record.alike import check_alike, check_members, conditions

IDENTITY: dict[str, Any] = {
    "task": "gentle_scratch",
    "stochastic": False,
    "egos": [["mine", "a" * 64]],
    "partners": [["scratch/ippo-d1-s0-v1/human", "d1", "test", "b" * 64, [1.0, 0.5]]],
    "software": {"jax": "0.7.0"},
}


def other(**changed: Any) -> dict[str, Any]:
    return {**IDENTITY, **changed}


def test_policies_and_software_are_no_conditions() -> None:
    others = other(egos=[], partners=[], software={"jax": "0.8.0"})
    check_alike({"a": conditions(IDENTITY), "b": conditions(others)})
    stranger = ["scratch/ippo-d1-s1-v1/human", "d1", "test", "d" * 64, None]
    check_members({"a": IDENTITY, "b": other(partners=[stranger])}, "partners")


def test_only_named_fields_are_compared() -> None:
    jobs = {"a": IDENTITY, "b": other(stochastic=True)}
    check_alike(jobs, ["task"])
    with pytest.raises(ValueError, match="series is none in a and 4 in b; play both"):
        check_alike({"a": IDENTITY, "b": other(series=4)})
    with pytest.raises(ValueError, match="stochastic is false in a and true in b; ask again"):
        check_alike(jobs, ["task", "stochastic"], advice="ask again")


@pytest.mark.parametrize("rows", [None, "mine", [["mine"]], [[1, "a"]], ["mine"]])
def test_strange_members_are_refused(rows: Any) -> None:
    with pytest.raises(ValueError, match="the manifest of b names no egos"):
        check_members({"a": IDENTITY, "b": other(egos=rows)}, "egos")
