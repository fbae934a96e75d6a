"""Modules compute what Python computes: physics to the bit, all else within 1e-5."""

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.seat.trajectories import NODE, TASKS, differences, played, traces_of
from tests.system import needs
from tools.seat.golden import STEPS, packed

pytestmark = [pytest.mark.slow, needs("nodejs", NODE), pytest.mark.usefixtures("optimised")]
CLOSE = 1e-5
# Spring and damper of a joint turn 1e-6 rad into 1e-4 N m: what a visitor's body does is recorded,
# and not computed again.
BODY = ("body", "human", "view['intended']")
MOVED = 5e-3
SUMS = 1e-4  # of a thousand steps


@pytest.fixture(scope="module", params=TASKS)
def task(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def given(task: str) -> dict[str, Any]:
    return played(task)


def test_a_module_agrees_with_python(task: str, given: dict[str, Any], tmp_path: Path) -> None:
    found = differences(task, given, tmp_path)
    state = {name for name in found if name.startswith("state")}
    assert {"state.obs['robot']", "state.obs['human']", "state.reward", "state.step"} <= state
    assert {"carry", "robot", "script", "told", "tally.returns", "view['tool']"} <= set(found)
    for name, one in found.items():
        if name.startswith("state.physics"):
            assert one["rows"] == 0, name
        elif name.startswith(BODY):
            assert one["off"] < MOVED, (name, one)
        else:
            most = SUMS if name.startswith("tally") else CLOSE
            assert one["off"] < most, (name, one)


def test_a_planted_difference_is_found(task: str, given: dict[str, Any], tmp_path: Path) -> None:
    traces = traces_of(task)
    places = traces.layout.trees["state"][0]
    at = next(place for place in places if place.name == ".reward").offset - places[0].offset
    rows = (
        np.frombuffer(base64.b64decode(given["rows"]["state"]), np.float32)
        .reshape(STEPS, -1)
        .copy()
    )
    rows[STEPS // 2, at] += 1e-4
    planted = given | {"rows": given["rows"] | {"state": packed(rows)}}
    found = differences(task, planted, tmp_path)
    assert found["state.reward"]["off"] > CLOSE
    assert found["state.reward"]["at"] == STEPS // 2
