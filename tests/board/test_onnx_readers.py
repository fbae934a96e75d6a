"""One reader of ONNX files: at home and at a board a file is the same robot, or is refused."""

import importlib
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import onnxruntime
import pytest

from assistax_board.problems import Refusal
from assistax_board.robots.admission import Admission
from evaluation.cast.egos import EgoError, call_ego, read_egos
from evaluation.cast.onnx_robots.admission import PLAYED_APART, admit_onnx, read_program
from evaluation.cast.onnx_robots.ego import UntrustedModelError
from evaluation.cast.roster import HostEgo
from population.networks.stack import flatten
from tests.board.onnx_files import ACT, OBS, ONNX_FILES, onnx_bytes
from zoo.registry import Registry

EMPTY: Any = Registry(data=None, path=Path("registry.json"), policies=[])  # type: ignore[arg-type]
BATCH = np.random.default_rng(1).normal(size=(2, 4, OBS)).astype(np.float32)
# Files that onnxruntime plays at home though a board has no program of them, and says so.
APART = {"opset 9", "opset 11", "opset 23", "free width", "second output of ints", "lstm"}
OTHER_WIDTHS = {"wrong observations", "wrong actions"}  # sound files of another task


def at_home(data: bytes, folder: Path) -> Any:
    """Return the robot's stack at home, or None where it is refused."""
    (folder / "robot.onnx").write_bytes(data)
    try:
        [stack] = read_egos([f"onnx:{folder}/robot.onnx"], EMPTY, "scratch").stacks
    except EgoError as error:
        assert str(error).isprintable()
        return None
    return stack


def at_a_board(data: bytes) -> Any:
    """Return the robot at a board, or the word by which it is refused."""
    try:
        return Admission({"scratch": (OBS, ACT)}).read(data, "scratch")
    except Refusal as refusal:
        return refusal.code


@pytest.mark.parametrize("name", ONNX_FILES)
def test_home_and_board_read_a_file_alike(name: str, tmp_path: Path) -> None:
    data = onnx_bytes(name)
    home, board = at_home(data, tmp_path), at_a_board(data)
    if name in OTHER_WIDTHS:
        assert board == "wrong_sizes" and home.spec == read_program(data)[0]
    elif isinstance(board, str):
        assert (home is not None) == (name in APART)
        assert name not in APART or (isinstance(home, HostEgo) and board in PLAYED_APART)
    else:
        assert home.spec == board.spec
        mine, theirs = flatten(home.row(0)), flatten(board.params)
        assert mine.keys() == theirs.keys()
        for leaf in mine:
            np.testing.assert_array_equal(mine[leaf], theirs[leaf])


@pytest.mark.parametrize("name", ["free width", "lstm", "opset 9", "opset 23"])
def test_onnx_beyond_board_limits_plays_at_home(name: str, tmp_path: Path) -> None:
    ego = at_home(onnx_bytes(name), tmp_path)
    answer = call_ego(ego, ["a"], 4, ACT)(BATCH[0], 0)
    [expected] = session(onnx_bytes(name)).run(None, {"x": BATCH[0]})
    np.testing.assert_allclose(answer, expected, atol=1e-6)


@pytest.mark.parametrize("name", ONNX_FILES)
def test_an_admitted_file_plays_as_onnxruntime_has_it(name: str) -> None:
    try:
        program, params = admit_onnx(onnx_bytes(name), OBS, ACT)
        runs = session(onnx_bytes(name))
    except (UntrustedModelError, *onnxruntime_errors()):
        return
    policy, names = program.player(), [one.name for one in runs.get_inputs()]
    carry, theirs = policy.initial_carry((4,)), np.zeros((4, ACT), np.float32)
    for step, obs in enumerate(BATCH):
        first = np.full(4, step == 0)
        carry, actions = policy.act(params, carry, jnp.asarray(obs), jnp.asarray(first))
        rows = [
            runs.run(None, dict(zip(names, (obs[[i]], theirs[[i]], first[[i]]), strict=False)))
            for i in range(4)
        ]
        expected = np.concatenate([row[0] for row in rows])
        if len(names) > 1:
            theirs = np.concatenate([row[1] for row in rows])
        np.testing.assert_allclose(actions, np.clip(expected, -1.0, 1.0), atol=1e-5)


def session(data: bytes) -> Any:
    return onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])


def onnxruntime_errors() -> tuple[type[Exception], ...]:
    state: Any = importlib.import_module("onnxruntime.capi.onnxruntime_pybind11_state")
    return state.Fail, state.InvalidGraph, state.NotImplemented, state.InvalidArgument
