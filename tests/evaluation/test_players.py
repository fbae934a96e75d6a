"""Whatever sits in a seat: its spec makes its player."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_board.robots.admission import Admission
from evaluation.cast.baseline_policies import ReferenceSpec, ScriptSpec
from evaluation.cast.onnx_robots.admission import read_program
from population.networks.onnx_export import to_onnx
from population.networks.policy import Policy
from population.networks.seat import Seat
from tests.untrained import ROBOT, params_of

SIZES = ROBOT.observation_size, ROBOT.action_size


def onnx() -> tuple[Seat, Any]:
    return read_program(to_onnx(ROBOT, params_of(ROBOT, 3)))


SEATS = {
    "network": lambda: (ROBOT, params_of(ROBOT, 3)),
    "random": lambda: (ReferenceSpec("robot", *SIZES), {"amplitude": np.float32(1.0)}),
    "script": lambda: (ScriptSpec("robot", *SIZES, task="scratch"), {}),
    "onnx": onnx,
}


@pytest.mark.parametrize("name", SEATS)
def test_spec_makes_player(name: str) -> None:
    spec, params = SEATS[name]()
    player, rows = spec.player(), 3
    assert (spec.role, spec.observation_size, spec.action_size) == ("robot", *SIZES)
    assert {spec: name}[SEATS[name]()[0]] == name, "what is compiled is kept by spec"
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(rows, SIZES[0])), jnp.float32)
    carry, first = player.initial_carry((rows,)), jnp.ones(rows, bool)
    _, action = jax.jit(player.act)(params, carry, obs, first)
    assert action.shape == (rows, SIZES[1]) and float(jnp.abs(action).max()) <= 1.0


def test_board_plays_player_of_spec() -> None:
    params = params_of(ROBOT, 3)
    data = to_onnx(ROBOT, params)
    robot = Admission({"scratch": SIZES}).read(data, "scratch")
    obs, first = jnp.full((2, SIZES[0]), 0.3), jnp.ones(2, bool)
    _, action = robot.spec.player().act(robot.params, (), obs, first)
    _, expected = Policy(ROBOT).act(params, (), obs, first)
    np.testing.assert_allclose(action, expected, atol=1e-5)
