"""What a robot costs is counted from its graph, and what would take hours is not let in."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from onnx import helper

from assistax_board.problems import Refusal
from assistax_board.robots.admission import Admission
from assistax_board.robots.robot_cost import MOST, NUMBER, PRODUCT, nanoseconds
from population.networks.onnx_export import to_onnx
from population.networks.spec import PolicySpec
from tests.board.fakes import TASK
from tests.board.test_limited import ACT, OBS, SIZES, file_of
from tests.untrained import params_of

WIDE = 65_536


def wide(nodes: list[Any]) -> bytes:
    """Return a robot whose nodes start from the wide value v0 and end with the value of `last`."""
    constants = {"w": np.ones((OBS, 1), np.float32), "o": np.ones((1, WIDE), np.float32)}
    constants |= {"s": np.array([0]), "e": np.array([ACT]), "a": np.array([1])}
    begin = [helper.make_node("MatMul", ["obs", "w"], ["x"])]
    begin.append(helper.make_node("Mul", ["x", "o"], ["v0"]))
    end = [helper.make_node("Slice", ["last", "s", "e", "a"], ["action"])]
    return file_of([*begin, *nodes, *end], constants, "action")


def tanhs(count: int) -> bytes:
    names = [*(f"v{place}" for place in range(count)), "last"]
    return wide([helper.make_node("Tanh", [old], [new]) for old, new in pairwise(names)])


def gigabytes() -> bytes:
    """Return a robot that needs a hundred wide values at once."""
    added = [helper.make_node("Tanh", [f"v{i}"], [f"v{i + 1}"]) for i in range(100)]
    sums = [helper.make_node("Add", [f"v{99 - i}", f"s{i}"], [f"s{i + 1}"]) for i in range(99)]
    last = [helper.make_node("Identity", ["v100"], ["s0"])]
    end = [helper.make_node("Identity", ["s99"], ["last"])]
    return wide([*added, *last, *sums, *end])


@pytest.mark.parametrize(
    "data", [tanhs(280), tanhs(12), gigabytes()], ids=["a day", "too long", "gigabytes"]
)
def test_robot_of_hours_or_gigabytes_is_refused(data: bytes) -> None:
    with pytest.raises(Refusal) as refusal:
        Admission(SIZES).read(data, TASK)
    assert refusal.value.code == "too_slow"


@pytest.mark.parametrize("torso", ["mlp", "gru"])
@pytest.mark.slow
def test_large_networks_are_let_in(torso: Any) -> None:
    spec = PolicySpec("robot", OBS, ACT, torso=torso, hidden=(512, 512), activation="relu")
    params = params_of(spec, 0)
    assert nanoseconds(spec.player(), params, OBS) < MOST / 5
    assert Admission(SIZES).read(to_onnx(spec, params), TASK).format == "onnx"


def test_cost_of_weights_is_shared_by_rows() -> None:
    """PyTorch writes weights transposed: a million numbers, once a step and not once a row."""
    constants = {"w": np.ones((1024, OBS), np.float32), "u": np.ones((ACT, 1024), np.float32)}
    nodes = [helper.make_node("Gemm", ["obs", "w"], ["h"], transB=1)]
    nodes.append(helper.make_node("Gemm", ["h", "u"], ["action"], transB=1))
    robot = Admission(SIZES).read(file_of(nodes, constants, "action"), TASK)
    measured = nanoseconds(robot.spec.player(), robot.params, OBS)
    transposed = 1024 * (OBS + ACT)
    assert PRODUCT * transposed < measured < PRODUCT * transposed + NUMBER * transposed / 10
