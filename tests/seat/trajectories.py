"""Trajectories of Python's that modules are held against, in Node."""

import json
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from evaluation.seat.modules import file_name, playable
from tools.seat.__main__ import MODULES, ROBOT
from tools.seat.golden import STEPS, begun, memory_of, packed, trajectory
from tools.seat.traces import TaskTraces
from zoo.registry import load_registry

NODE = shutil.which("node")
TASKS = playable()
SEED = 3


@cache
def traces_of(task: str) -> TaskTraces:
    """Return the traced functions of a task, after which its layout is complete."""
    traces = TaskTraces(task, load_registry().policy(ROBOT.format(task=task)).spec)
    traces.text()
    return traces


def robot_of(task: str) -> Any:
    """Return the parameters of a published robot."""
    registry = load_registry()
    (stack,) = registry.stacks([registry.policy(ROBOT.format(task=task))])
    return jax.tree.map(np.asarray, stack.row(0))


def pointer_path(traces: TaskTraces, steps: int = STEPS) -> np.ndarray:
    """Return what a visitor points at [T, P]: waves about the start."""
    time = np.arange(steps) / 50.0
    waves = np.stack([np.sin(time), np.sin(0.7 * time), np.sin(0.9 * time)], axis=1)
    state, body, _ = begun(traces, SEED)
    if traces.visitor.at_mouth:
        jaw = 0.25 + 0.25 * np.sin(1.3 * time)
        still = np.zeros(steps)
        head = 0.1 * waves[:, 0], 0.2 * waves[:, 1], 0.3 * waves[:, 2], still, jaw
        return np.stack(head, axis=1).astype(np.float32)
    hand = np.asarray(traces.visitor.place(body, state.obs["human"])[0])
    held = np.sin(0.3 * time) > -0.5
    return np.column_stack([hand + 0.15 * waves, held]).astype(np.float32)


def played(task: str) -> dict[str, Any]:
    """Return the trajectory of a task for `agree.mjs`, JSON-ready."""
    traces, rng = traces_of(task), np.random.default_rng(SEED)
    words = np.where(rng.random(STEPS) < 0.02, rng.integers(1, 9, STEPS), 0)
    params, pointer = robot_of(task), pointer_path(traces)
    rows = trajectory(traces, params, pointer, words, SEED)
    return {
        "rows": {name: packed(row) for name, row in rows.items()},
        "params": packed(memory_of(params)),
        "pointer": packed(pointer),
        "words": words.tolist(),
    }


def differences(task: str, given: dict[str, Any], folder: Path) -> dict[str, dict[str, float]]:
    """Return how far a module is from a trajectory: by leaf "off", "rows" and "at"."""
    path = folder / "trajectory.json"
    path.write_text(json.dumps(given))
    files = [MODULES / file_name(task, part) for part in ("wasm", "layout")]
    command = [str(NODE), str(Path(__file__).with_name("agree.mjs")), *map(str, files), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)["found"]
