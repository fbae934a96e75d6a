"""LeRobot's own library reads what `trajectories --format lerobot` writes; see tools/frameworks.sh.

It wants huggingface-hub below 2 and stands in an environment of its own, `$LEROBOT_PYTHON`.
"""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import assistax_zoo as az
from assistax_zoo.datasets import write_dataset

STEPS = 6
PYTHON = os.environ.get("LEROBOT_PYTHON")
pytestmark = pytest.mark.skipif(not PYTHON, reason="see tools/frameworks.sh")


def test_lerobot_reads_what_was_recorded(tmp_path: Path) -> None:
    table = az.trajectories(
        "random", "random", task="gentle_scratch", episodes=2, steps=STEPS, backend="native"
    )
    about = {"task": "gentle_scratch", "human": {"policy": "random"}}
    write_dataset(table, tmp_path / "pair", about, "lerobot")
    reader = Path(__file__).with_name("read_lerobot.py")
    command = [str(PYTHON), "-P", str(reader), str(tmp_path / "pair")]
    environment = {**os.environ, "HF_HOME": str(tmp_path / "hub"), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    read = json.loads(done.stdout)
    steps = table.drop_nulls("reward")
    actions = steps["robot_action"].to_numpy()
    assert (read["episodes"], read["fps"], read["task"]) == (
        2,
        50,
        "gentle scratch, with the human random",
    )
    np.testing.assert_allclose(read["state"], steps["robot_observation"].to_numpy(), rtol=1e-6)
    np.testing.assert_allclose(read["action"], actions, rtol=1e-6)
    np.testing.assert_allclose(read["reward"], steps["reward"].to_numpy(), rtol=1e-6)
    np.testing.assert_allclose(read["mean"], actions.mean(0), atol=1e-6)
    assert read["done"] == (steps["terminated"] | steps["truncated"]).to_list()
    assert read["batch"] == [4, *steps["human_observation"].to_numpy().shape[1:]]
    second = actions[STEPS:]
    following = np.concatenate([second[1:], second[-1:]])  # the last action stands for what is cut
    np.testing.assert_allclose(read["ahead"], np.stack([second, following], 1), rtol=1e-6)
