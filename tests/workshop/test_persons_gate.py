"""Robots learn with persons and play with strangers; gates are read from what each earned."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assistax_envs.tasks.chain import SCRIPTS
from assistax_workshop.gates import persons, persons_play, persons_reading
from assistax_workshop.gates.persons import run_stages
from assistax_workshop.gates.persons_play import SINGLE, STRANGERS, Plan
from assistax_workshop.gates.persons_table import FEW, gates_of_persons, read_stages

TASK = "gentle_scratch"


@pytest.mark.slow
def test_stages_write_returns_by_robot_and_person(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(persons_play, "SIDE", 3)
    monkeypatch.setattr(persons_play, "SINGLE_EPISODES", 2)
    lines: list[str] = []
    monkeypatch.setattr(persons_reading, "READERS", 3)
    changes = {"num_envs": 4}
    plan = Plan(TASK, tmp_path, (0, 1), 600, 2, 25, 2, changes, horizon=30)
    run_stages(plan, ("told", "best", "script", "search", "read"), lines.append)
    files = read_stages(tmp_path)
    assert [line.partition(":")[0] for line in lines if not line.startswith("stage ")] == [
        *(f"told with {side}" for side in STRANGERS),
        f"best with {SINGLE}",
        *(f"script with {side}" for side in (SINGLE, *STRANGERS)),
        *(f"search, round {turn} of 5" for turn in range(1, 6)),
        *(f"search with {side}" for side in STRANGERS),
        "preferences read by probe",
        "preferences read by script",
    ]
    found = files["search"]
    assert len(found["scores"]) == 25 and set(found["numbers"]) == set(SCRIPTS[TASK].ranges)
    assert np.shape(found["sides"]["corners"]["return"]) == (2, 3, 2)
    read = [gate.told for gate in gates_of_persons(TASK, files) if "read" in gate.gate]
    assert read and set(read) == {FEW}
    assert np.shape(files["told"]["sides"]["muscle"]["return"]) == (2, 3, 2)
    for name in ("best", "script"):
        side = files[name]["sides"][SINGLE]
        assert side["persons"] == [0, 4500]
        assert np.shape(side["return"]) == np.shape(side["safe_success"]) == (1, 2, 2)
    before = json.loads((tmp_path / "told.json").read_text())
    run_stages(plan, ("told",), lines.append)  # trained already: only played again
    assert json.loads((tmp_path / "told.json").read_text()) == before


def test_each_stage_is_told_with_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    # Nothing public runs a stage without hours of training.
    monkeypatch.setattr(persons, "_stage", lambda *_: {})
    run_stages(Plan(TASK, tmp_path), ("ppo", "read"), lines.append)
    assert lines == ["stage 1 of 2, ppo", "stage 2 of 2, read"]
    with pytest.raises(ValueError, match="stage is 'pp'; allowed are ppo, told"):
        run_stages(Plan(TASK, tmp_path), ("pp",))


def _stage(mean: float, robots: int, people: int, seed: int, side: str = "validation") -> Any:
    rng = np.random.default_rng(seed)
    shapes = {(robots, 1, 1): 5.0, (1, people, 1): 5.0, (robots, people, 1): 10.0}
    noise = sum(rng.normal(0.0, spread, shape) for shape, spread in shapes.items())
    returns = mean + noise + rng.normal(0.0, 5.0, (robots, people, 4))
    safe = (returns > 80.0).astype(int)
    figures = {"return": returns.tolist(), "safe_success": safe.tolist()}
    return {
        "about": {"steps": 50_000_000},
        "sides": dict.fromkeys(STRANGERS, figures) | {side: figures},
    }


def _found(files: dict[str, Any]) -> dict[str, Any]:
    return {gate.gate: gate for gate in gates_of_persons(TASK, files)}


def test_gates_are_read_from_what_was_earned() -> None:
    files = {
        name: _stage(mean, 8, 60, seed)
        for seed, (name, mean) in enumerate(
            {"ppo": 100.0, "told": 130.0, "gru": 120.0, "idle": 60.0}.items()
        )
    }
    files |= {"best": _stage(130.0, 1, 50, 8, SINGLE), "script": _stage(60.0, 1, 50, 9, SINGLE)}
    found = _found(files)
    assert found["best response to one person"].holds
    for what in ("return", "safe success"):
        assert found[f"script with the same persons: {what}"].holds
    idle = found["robot trained with idle persons"]
    assert idle.holds
    assert idle.value == pytest.approx(0.4, abs=0.1)
    told = found["told the preference, muscle: more"]
    assert told.holds
    assert told.ci[0] < 0.3 < told.ci[1]
    back = found["a memory wins back, of that"]
    assert back.value == pytest.approx(2 / 3, abs=0.2)
    # Of 25 + 25 + 100 what pairs bring, by the variances that were drawn.
    assert found["who meets whom, share of variance"].value == pytest.approx(2 / 3, abs=0.12)
    assert found["numbers inside their ranges"].value == 1.0


def test_a_script_is_held_against_its_search() -> None:
    for own, holds in ((57.0, True), (20.0, False)):
        search = _stage(60.0, 2, 60, 3)
        returns = np.zeros((2, 60, 2)) + np.array([60.0, own])[:, None, None]
        search["sides"]["validation"]["return"] = returns.tolist()
        search["about"]["tries"] = 200
        gate = _found({"search": search})["script beside the best of a search"]
        assert gate.holds is holds and gate.value == pytest.approx(own / 60.0)


def test_gates_that_are_missed_say_so() -> None:
    files = {name: _stage(100.0, 8, 60, seed) for seed, name in enumerate(("ppo", "told", "idle"))}
    files |= {"best": _stage(85.0, 1, 50, 8, SINGLE), "script": _stage(84.0, 1, 50, 9, SINGLE)}
    found = _found(files)
    for name in (
        "best response to one person",
        "script with the same persons: return",
        "script with the same persons: safe success",
        "robot trained with idle persons",
        "told the preference, muscle: more",
    ):
        assert found[name].holds is False, name
    assert "needs gru" in found["a memory wins back, of that"].told


def test_nothing_measured_is_nothing_met() -> None:
    found = _found({})
    measured = [gate.gate for gate in found.values() if gate.value is not None]
    assert measured == ["numbers inside their ranges"]
    assert all(gate.holds is None for gate in found.values() if gate.gate not in measured)


def test_wish_is_read_if_interval_exceeds_chance() -> None:
    def shares(share: float) -> dict[str, Any]:
        found = {"share": share, "of": 300, "shuffled": 0.33}
        return {"2": found, "5": found}

    read = {"gru": {"liked_force": shares(0.5), "liked_speed": shares(0.36)}, "script": {}}
    found = _found({"read": {"read": read}})
    assert found["liked_force, read in 5 s"].holds
    assert found["liked_force, read in 2 s"].holds is None  # stated
    assert found["liked_speed, read in 5 s"].holds is False
    low, high = found["liked_force, read in 5 s"].ci
    assert low == pytest.approx(0.5 - 0.0566, abs=1e-3) and high == pytest.approx(0.5566, abs=1e-3)
