"""Gentle feeding: the mouth's scene, the stages of a bite and their pay, a pair that eats."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from assistax_envs import disability_params
from assistax_envs.models import build_model
from assistax_envs.models.care_scenes import OPEN, SEAT, STIFF_JOINTS
from assistax_envs.preferences import PREFERENCES, WORDS
from assistax_envs.tasks.base import HUMAN_ACTUATORS, HUMAN_JOINTS, human_actuators, human_joints
from assistax_envs.tasks.care import WHATEVER
from assistax_envs.tasks.gentle_feeding.task import (
    ASKED,
    MEAL,
    SERVE,
    SPILT,
    FeedState,
)
from assistax_envs.tasks.mouth import (
    ENTERING,
    FULL,
    LEAVING,
    TAKING,
    WAITING,
    MouthReadings,
)
from assistax_envs.versions import GENTLE_TASKS, PAPER_TASKS
from tests.envs.conftest import compiled, environment
from tests.envs.mouth import LaidOut, meal

TASK = "gentle_feeding"


# The scene.


@pytest.mark.parametrize("task", [*PAPER_TASKS, *GENTLE_TASKS])
def test_seat_is_an_arm(task: str) -> None:
    model = build_model(task)
    assert human_joints(model) == HUMAN_JOINTS
    assert human_actuators(model) == HUMAN_ACTUATORS


def test_the_seat_is_trunk_neck_and_jaw() -> None:
    model = build_model(TASK)
    assert human_actuators(model) == tuple(f"human_{name}" for name in SEAT)
    assert set(STIFF_JOINTS["mouth"]) < set(human_joints(model))


def settled(**torques: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the scene after 3 s of constant torques of the seat."""
    model = build_model(TASK)
    data = mujoco.MjData(model)
    for name, share in torques.items():
        data.ctrl[model.actuator(f"human_{name}").id] = share
    mujoco.mj_step(model, data, 600)
    return model, data


def test_mouth_opens_by_four_centimetres() -> None:
    for torque, opening in ((0.0, 0.0), (1.0, 0.042)):
        _, data = settled(jaw=torque)
        lips = data.geom("human_upper_lip").xpos - data.geom("human_lower_lip").xpos
        gap = float(np.linalg.norm(lips)) - 0.016
        assert gap == pytest.approx(opening, abs=0.004)


def test_trunk_leans_and_neck_turns_as_far_as_designed() -> None:
    model, still = settled()
    _, leant = settled(abdomen_y=1.0)
    shift = leant.site("human_mouth").xpos - still.site("human_mouth").xpos
    assert 0.05 < shift[0] < 0.07 and abs(shift[1]) < 0.005
    for name in ("neck_pitch", "neck_yaw", "neck_roll"):
        _, turned = settled(**{name: 1.0})
        joint = model.joint(f"human_{name}")
        angle = turned.qpos[joint.qposadr[0]]
        assert 0.4 < angle < joint.range[1] + 0.02


def test_disability_narrows_mouth_and_neck() -> None:
    env = environment(TASK, "native")
    # The ranges that impairments leave.
    full, narrow = np.asarray(env._joint_range(disability_params(["d1", "d7"])))
    jaw = env.model.joint("human_jaw").id
    assert full[jaw].tolist() == [0.0, OPEN]
    assert narrow[jaw] == pytest.approx([0.0, 0.7 * OPEN])


def test_mouth_readings_match_mujoco() -> None:
    env = environment(TASK, "native")
    model, rng = env.model, np.random.default_rng(3)
    data = mujoco.MjData(model)
    for _ in range(5):
        low, high = model.jnt_range.T
        data.qpos[:] = rng.uniform(low, high)
        mujoco.mj_forward(model, data)
        values = jnp.asarray(data.sensordata[None], jnp.float32)
        # Sensors of values that are made by hand.
        read = env._sensors.read(values)
        assert isinstance(read, MouthReadings)
        mouth, tool = data.site("human_mouth"), data.site("robot_end_effector")
        local = mouth.xmat.reshape(3, 3).T @ (tool.xpos - mouth.xpos)
        np.testing.assert_allclose(read.bowl[0], local, atol=1e-5)
        np.testing.assert_allclose(read.level[0], tool.xmat.reshape(3, 3)[2, 0], atol=1e-5)
        head = data.geom("human_head")
        face = np.linalg.norm(tool.xpos - head.xpos) - model.geom("human_head").size[0]
        np.testing.assert_allclose(read.face[0], face, atol=1e-5)
        jaw = data.qpos[model.joint("human_jaw").qposadr[0]]
        np.testing.assert_allclose(read.jaw[0], jaw, atol=1e-6)


# A bite.


class Table(LaidOut):
    """One simulation of the task, whose readings a test lays out by hand."""

    def __init__(self, preference: str = "p5") -> None:
        super().__init__(TASK, preference)
        zero = jnp.zeros(1, jnp.int32)
        self.state: FeedState = dataclasses.replace(
            self.begun, stage=zero, held=zero, left=jnp.full(1, jnp.nan), shut=jnp.ones(1, bool)
        )

    def play(
        self,
        out: float,
        jaw: float,
        bite: float = 0.0,
        level: float = 1.0,
        aside: float = 0.0,
        steps: int = 1,
        speed: float = 0.0,
    ) -> dict[str, float]:
        """Return the weighted terms, summed over equal steps."""
        readings = dataclasses.replace(
            self.read,
            bowl=jnp.array([[out, aside, 0.0]], jnp.float32),
            jaw=jnp.array([jaw], jnp.float32),
            felt=jnp.array([[bite, 0.0]], jnp.float32),
            level=jnp.array([level], jnp.float32),
            tool_velocity=jnp.array([[speed, 0.0, 0.0]], jnp.float32),
            force=jnp.array([bite], jnp.float32),
            on_arm=jnp.array([bite], jnp.float32),
            hurt=jnp.zeros(1, bool),
        )
        return self.after(readings, steps)

    @property
    def stage(self) -> int:
        return int(self.state.stage[0])

    def eat(self) -> None:
        """Take one bite as it is liked best."""
        # For a second: what a spoon does is smoothed, and the one before came back farther.
        self.play(self.preference.wait, 0.0, steps=50)
        self.play(self.preference.wait, 0.4)
        self.play(-self.preference.depth, 0.4, steps=SERVE)
        self.play(-self.preference.depth, 0.15, bite=2.0, steps=15)
        self.play(0.09, 0.15)
        self.play(0.09, 0.0)


def test_bite_pays_each_stage_once() -> None:
    table = Table()
    assert table.play(0.08, 0.0)["open"] == 0.0 and table.stage == WAITING
    assert table.play(0.08, 0.4)["open"] == pytest.approx(20.0) and table.stage == ENTERING
    assert table.play(0.08, 0.4, steps=50)["open"] == 0.0
    assert table.play(-0.02, 0.4, steps=SERVE)["serve"] == pytest.approx(20.0)
    assert table.stage == TAKING
    assert table.play(-0.02, 0.15, bite=2.0, steps=15)["take"] == pytest.approx(10.0)
    assert table.stage == LEAVING and int(table.state.bites[0]) == 0
    assert table.play(0.09, 0.1)["leave"] == pytest.approx(20.0)
    assert table.stage == WAITING and int(table.state.bites[0]) == 1
    # A mouth that stays open asks for nothing: it has to close in between.
    assert Table().play(0.08, 0.4)["open"] > 0.0
    open_still = Table()
    open_still.eat()
    assert open_still.stage == WAITING


@pytest.mark.parametrize(
    "wrong",
    [
        {"out": -0.004},  # on the lips
        {"out": -0.04},  # in the throat
        {"aside": 0.015},
        {"level": 0.95},
        {"jaw": 0.2},
        {"speed": 0.2},
    ],
)
def test_misplaced_spoon_is_not_served(wrong: dict[str, float]) -> None:
    table = Table()
    table.play(0.08, 0.0)
    table.play(0.08, 0.4)
    table.play(**{"out": -0.02, "jaw": 0.4, "steps": 100} | wrong)
    assert table.stage == ENTERING


@pytest.mark.parametrize("bite", [0.2, 20.0])
def test_light_or_hard_bites_take_nothing(bite: float) -> None:
    table = Table()
    table.play(0.08, 0.0)
    table.play(0.08, 0.4)
    table.play(-0.02, 0.4, steps=SERVE)
    table.play(-0.02, 0.15, bite=bite, steps=50)
    assert table.stage == TAKING


def test_mouth_stays_shut_for_misplaced_or_fast_spoons() -> None:
    for wrong in ({"aside": 0.1}, {"out": 0.3}, {"out": 0.0}):
        table = Table()
        table.play(0.08, 0.0)
        table.play(**{"out": 0.08, "jaw": 0.4} | wrong)
        assert table.stage == WAITING
    table = Table()
    table.play(0.08, 0.0, speed=0.5, steps=20)
    table.play(0.08, 0.4, speed=0.5)
    assert table.stage == WAITING


@pytest.mark.parametrize("name", ["p1", "p5", "p9"])
def test_waiting_and_depth_pay_by_preference(name: str) -> None:
    paid = {}
    for wait in (0.04, 0.08, 0.16):
        table = Table(name)
        table.play(wait, 0.0)
        paid[wait] = table.play(wait, 0.4)["open"]
    likes = PREFERENCES[name]
    assert max(paid, key=lambda wait: paid[wait]) == likes.wait
    assert paid[likes.wait] == pytest.approx(20.0)
    served = {}
    for depth in (0.012, 0.02, 0.028):
        table = Table(name)
        table.play(0.08, 0.0)
        table.play(0.08, 0.4)
        served[depth] = table.play(-depth, 0.4, steps=SERVE)["serve"]
    assert max(served, key=lambda depth: served[depth]) == likes.depth
    assert min(*paid.values(), *served.values()) >= 20.0 * WHATEVER
    # Twice or half of the wish earns a fifth: who does not listen earns little.
    assert max(paid[wait] for wait in paid if wait != likes.wait) < 5.0


def test_spill_takes_back_the_pay_of_the_bite() -> None:
    table = Table()
    table.play(0.16, 0.0)
    before = table.total
    table.play(0.16, 0.4)
    table.play(0.02, 0.4)
    table.play(-0.02, 0.4, steps=SERVE)
    assert table.total > before + 20.0
    spilt = table.play(-0.02, 0.4, level=SPILT - 0.01)
    assert table.stage == WAITING
    assert spilt["spill"] < -10.0
    assert table.total < before - 5.0


def test_tilted_spoon_spills_once_until_level_again() -> None:
    table = Table()
    paid = [table.play(0.16, 0.0, level=SPILT - 0.01, steps=5)]
    paid += [table.play(0.16, 0.0), table.play(0.16, 0.0, level=SPILT - 0.01, steps=5)]
    assert sum(terms["spill"] for terms in paid) == pytest.approx(-20.0)
    assert table.stage == WAITING


def test_to_and_fro_earns_nothing() -> None:
    """Progress is a change of the way that is left: a way back to the start sums to zero."""
    table = Table()
    ways = [0.2, 0.3, 0.18, 0.25, 0.2]
    assert sum(table.play(out, 0.0)["progress"] for out in ways) == pytest.approx(0.0, abs=1e-4)
    table.play(0.08, 0.4)
    ways = [0.08, 0.0, 0.05, -0.005, 0.08]
    assert table.stage == ENTERING
    assert sum(table.play(out, 0.4)["progress"] for out in ways) == pytest.approx(0.0, abs=1e-4)


def test_three_bites_succeed_and_six_pay() -> None:
    table = Table()
    for bite in range(MEAL):
        assert bool(table.measures.success[0] if bite else False) == (bite >= ASKED)
        table.eat()
    assert table.stage == FULL
    before = table.total
    table.eat()
    assert table.total == pytest.approx(before, abs=1e-3)
    # A bite pays 20 + 20 + 10 + 20, two holds of 5, and 10 cm back. Else this spoon jumps.
    assert before == pytest.approx(MEAL * 90.0, rel=1e-3)


# Who is needed.


@pytest.mark.slow
def test_scripted_pair_eats_unlike_idle_human() -> None:
    env = environment(TASK, "fused")
    _, states = meal(env, 32, 1000)
    violated = np.asarray(states.terminated).any(axis=0)
    assert violated.mean() < 0.1
    assert float((states.task.bites[-1] == MEAL).mean()) > 0.8
    # Care succeeds by chance: the script feeds all humans alike, whatever they like.
    assert 0.05 < float(states.measures.success[-1].mean()) < 0.5
    _, idle = meal(env, 32, 1000, human=lambda obs: jnp.zeros((obs.shape[0], 5)))
    assert not bool(idle.measures.success.any())
    assert int(idle.task.bites.max()) <= 1  # of starts with the spoon in the mouth


def test_script_waits_before_a_shut_mouth() -> None:
    """It is still 8 cm away after six seconds, wherever on the way in it began."""
    _, idle = meal(
        environment(TASK, "fused"), 16, 300, human=lambda obs: jnp.zeros((obs.shape[0], 5))
    )
    waits = np.asarray(idle.task.stage[-1]) == WAITING
    bowl = np.asarray(idle.obs["robot"][-1][:, 30:33]) / 10.0
    assert waits.sum() >= 4
    np.testing.assert_allclose(bowl[waits], [[0.08, 0.0, 0.0]] * waits.sum(), atol=0.01)


def test_episodes_start_anywhere_along_the_act() -> None:
    keys = jax.random.split(jax.random.key(2), 64)
    state = compiled(TASK, "fused")[0](keys, disability_params(["d1"] * 64))
    stages = np.bincount(np.asarray(state.task.stage), minlength=FULL)
    assert (stages[:FULL] > 2).all()
    assert not bool(state.measures.violated.any())


def test_human_alone_observes_its_preference() -> None:
    reset, keys = compiled(TASK, "fused")[0], jax.random.split(jax.random.key(5), 64)
    first, other = (
        reset(keys, disability_params(["d1"] * 64, [name] * 64)).obs for name in ("p1", "p9")
    )
    np.testing.assert_array_equal(first["robot"], other["robot"])
    for seat in ("human", "global"):
        same = np.asarray(first[seat] == other[seat]).all(axis=0)
        end = len(same) - (len(WORDS) if seat == "global" else 0)  # words come last
        assert np.flatnonzero(~same).tolist() == [end - 2, end - 1]
