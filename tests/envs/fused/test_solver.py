"""What the solver says of itself, and numbers that must not change without a new version."""

import hashlib
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from assistax_envs.physics.fused import generate
from assistax_envs.physics.fused.program import MAX_CONTACTS
from assistax_envs.versions import FUSED_VERSION
from tests.envs.fused.scenes import TASKS, Engine, States, engine, oracle, team_states

# A heavy bar over as many balls as can be asked for, each of which it touches.
ROW = """
<mujoco>
  <option integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    {balls}
    <body name="bar" pos="0 0 0.1">
      <joint axis="0 1 0" pos="-2 0 0" damping="1"/>
      <geom name="bar" type="capsule" fromto="0 0 0 2 0 0" size="0.05"/>
    </body>
  </worldbody>
  <contact>{pairs}</contact>
</mujoco>
"""
# Of angles, velocities and sensors after one control step of the first 200 states of trained teams.
GOLDEN = {
    "scratch": "e388656e7b05968e",
    "bed_bath": "719d7b80b91755c4",
    "arm_assist": "d15e93ca1d258d42",
    "gentle_scratch": "59514bf83e5831b0",
    "gentle_bath": "37683527b54034a9",
    "gentle_lift": "20901736454a8e61",
    "gentle_feeding": "b9827dcc729e5a3c",
    "gentle_brushing": "626aecf2c1617d94",
}


def row(number: int) -> tuple[mujoco.MjModel, Engine]:
    balls, pairs = "", ""
    for k in range(number):
        x = 0.05 + 1.9 * k / number
        balls += f'<geom name="ball{k}" type="sphere" pos="{x:.3f} 0 0.001" size="0.05"/>'
        pairs += f'<pair geom1="ball{k}" geom2="bar"/>'
    model = mujoco.MjModel.from_xml_string(ROW.format(balls=balls, pairs=pairs))
    return model, Engine(model)


@pytest.mark.parametrize("number", [MAX_CONTACTS, MAX_CONTACTS + 1, 40])
def test_too_many_contacts_are_never_silent(number: int) -> None:
    model, run = row(number)
    still = np.zeros((5, 1))
    states = States(np.array([[0.0], [-0.2], [0.0], [-0.2], [0.0]]), still, np.zeros((5, 0)))
    velocity = run(states)[1]
    touching = states.qpos[:, 0] == 0.0
    np.testing.assert_array_equal(np.isnan(velocity[:, 0]), touching & (number > MAX_CONTACTS))
    if number <= MAX_CONTACTS:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.ncon == number


@pytest.mark.parametrize("task", TASKS)
def test_nothing_is_left_unsettled(task: str) -> None:
    """Ten control steps of full torques from states of trained teams: none is given up."""
    states, ranges = team_states(task)
    rng = np.random.default_rng(13)
    for _ in range(10):
        qpos, qvel, _ = engine(task)(states, 4, ranges)
        assert np.isfinite(qvel).all()
        states = States(qpos, qvel, rng.choice([-1.0, 1.0], states.ctrl.shape))


@pytest.mark.parametrize("task", TASKS)
def test_golden_numbers(task: str) -> None:
    """The same bits on every machine; when they change, `FUSED_VERSION` goes up as well."""
    assert FUSED_VERSION == 1
    states, ranges = team_states(task)
    results = engine(task)(states[:200], 4, ranges[:200])
    assert hashlib.sha256(b"".join(x.tobytes() for x in results)).hexdigest()[:16] == GOLDEN[task]


def test_the_worked_example_is_what_is_generated() -> None:
    page = (Path(__file__).parents[3] / "docs/engine.md").read_text()
    model, *programs = re.findall(r"```(?:xml|cpp)\n(.*?)```", page, re.DOTALL)
    source = generate(mujoco.MjModel.from_xml_string(model)).source
    shown = [line.split("//")[0].strip() for text in programs for line in text.splitlines()]
    assert len(shown) > 10 and [line for line in shown if line not in source.splitlines()] == []


def test_a_model_without_contacts() -> None:
    page = (Path(__file__).parents[3] / "docs/engine.md").read_text()
    model = mujoco.MjModel.from_xml_string(re.findall(r"```xml\n(.*?)```", page, re.DOTALL)[0])
    states = States(np.array([[0.3], [1.02]]), np.array([[1.0], [2.0]]), np.array([[0.5], [-1.0]]))
    want = oracle(model, states, 4)
    for got, expected in zip(Engine(model)(states, 4), want, strict=True):
        np.testing.assert_allclose(got, expected, rtol=2e-6)
