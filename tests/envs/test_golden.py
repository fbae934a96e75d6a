"""Golden trajectories guard the environment's version: what they pin changes only together with
`VERSIONS`.

Fixed keys, fixed actions, the first 50 steps: where joints and tools went and what was earned. To
renew them after a version was raised: `python -m tests.envs.test_golden [TASK ...]`.
"""

import json
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from assistax_envs import TASKS, VERSIONS, disability_params, make
from tests.envs.conftest import backends, random_actions, seat

FOLDER = Path(__file__).parent / "golden"
SETTINGS = ["d1", "d9", "d3", "d7"]
STEPS = (1, 10, 25, 50)
# Columns of "global": joint angles of robot and human, rad.
ANGLES = {3: [*range(7), *range(21, 30)], 5: [*range(7), *range(24, 31)]}
# MJX's float32 parts from MuJoCo by millimetres once the arm touches, and sooner in velocities and
# forces.
TOLERANCES = {
    "native": {"global": 1e-4, "reward": 1e-4, "return": 1e-4},
    "mjx": {"reward": 3e-2, "return": 0.2},
}
FIRST_ANGLES = 5e-3  # rad, of either backend over the first 10 steps


def trajectory(task: str, backend: str) -> dict:
    """Return observations and rewards at `STEPS`, and the return so far, rounded to what is
    pinned.
    """
    env = make(task, backend)
    keys = jax.random.split(jax.random.key(20), len(SETTINGS))
    state, states = jax.jit(env.reset)(keys, disability_params(SETTINGS)), []
    step = jax.jit(env.step)
    for actions in random_actions(4, max(STEPS), seed=20, human=seat(task)):
        state = step(state, actions)
        states.append(state)
    picked = [states[step - 1] for step in STEPS]
    seen = {
        "global": [state.obs["global"] for state in picked],
        "reward": [state.reward for state in picked],
        "return": np.sum([np.asarray(state.reward, np.float64) for state in states], axis=0),
    }
    rounded = {
        name: np.asarray(values, np.float64).round(6).tolist() for name, values in seen.items()
    }
    return {"version": VERSIONS[task], **rounded}


@pytest.mark.slow_for("gentle_brushing", "gentle_feeding")
@pytest.mark.parametrize(
    ("task", "backend"),
    [
        pytest.param(task, tolerance, marks=[pytest.mark.slow] * (tolerance == "mjx"))
        for task in TASKS
        for tolerance in TOLERANCES
        if tolerance in backends(task)
    ],
)
def test_behaviour_changes_only_with_the_version(task: str, backend: str) -> None:
    golden = json.loads((FOLDER / f"{task}.json").read_text())
    assert golden["version"] == VERSIONS[task], (
        "the version was raised: renew the golden trajectory"
    )
    now = trajectory(task, backend)
    for name, tolerance in TOLERANCES[backend].items():
        np.testing.assert_allclose(np.array(now[name]), np.array(golden[name]), atol=tolerance)
    seen, pinned = (
        np.array(trajectory["global"])[:2, :, ANGLES[seat(task)]] for trajectory in (now, golden)
    )
    np.testing.assert_allclose(seen, pinned, atol=FIRST_ANGLES)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or TASKS:
        (FOLDER / f"{name}.json").write_text(json.dumps(trajectory(name, "native")) + "\n")
