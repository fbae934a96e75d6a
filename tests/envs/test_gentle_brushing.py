"""Gentle brushing: places on the teeth, strokes and their pay, and a pair that brushes."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from assistax_envs.models import build_model
from assistax_envs.models.care_scenes import TEETH
from assistax_envs.models.teeth import INNER, OFF, ORDER, PLACES, SHOWN_BY, places
from assistax_envs.preferences import PREFERENCES, PRESSES, SPEEDS
from assistax_envs.tasks.care import WHATEVER
from assistax_envs.tasks.gentle_brushing.task import (
    ASKED,
    AT,
    HALF,
    STROKE,
    STROKES,
    WELL,
    BrushState,
)
from assistax_envs.tasks.mouth import OPENED, TURNED
from tests.envs.conftest import environment
from tests.envs.mouth import LaidOut, meal

TASK = "gentle_brushing"


@pytest.mark.parametrize("jaw", [0.0, 0.25, 0.5])
def test_places_lie_on_their_rows_in_mujoco(jaw: float) -> None:
    """The lower ones swing with the jaw; a brush `OFF` along the normal just touches."""
    model = build_model(TASK)
    data = mujoco.MjData(model)
    data.qpos[model.joint("human_jaw").qposadr[0]] = jaw
    mujoco.mj_kinematics(model, data)
    mouth = data.site("human_mouth")
    frame = mouth.xmat.reshape(3, 3)
    middle, along, normal = places(jnp.arange(PLACES), jnp.full(PLACES, jaw))
    for number, (side, row, inner) in enumerate(ORDER):
        geom = data.geom(f"human_{side}_{row}_teeth")
        assert f"{side}_{row}_teeth" in TEETH
        np.testing.assert_allclose(mouth.xpos + frame @ middle[number], geom.xpos, atol=1e-6)
        axis = geom.xmat.reshape(3, 3)[:, 2]
        assert abs(axis @ (frame @ along[number])) == pytest.approx(1.0, abs=1e-5)
        assert float(along[number] @ normal[number]) == pytest.approx(0.0, abs=1e-6)
        # Outside is away from the mouth's middle, inside towards it.
        outward = float(normal[number] @ (middle[number] - jnp.array([-0.04, 0.0, 0.0])))
        assert (outward < 0.02) if inner else (outward > 0.0)
    sizes = model.geom("human_upper_front_teeth").size[0] + model.geom("robot_tool").size[0]
    assert OFF < sizes < OFF + 0.002


def test_brush_starts_before_its_place() -> None:
    """Within 5 mm of where it should be, and in nothing that would hurt."""
    model = build_model(TASK)
    data = mujoco.MjData(model)
    for number in range(PLACES):
        mujoco.mj_resetData(model, data)
        data.qpos[[model.joint(f"robot_joint{i}").qposadr[0] for i in range(1, 8)]] = AT[number]
        jaw = OPENED if INNER[number] else 0.0
        data.qpos[model.joint("human_jaw").qposadr[0]] = jaw
        data.qpos[model.joint("human_neck_yaw").qposadr[0]] = TURNED * SHOWN_BY[number]
        mujoco.mj_forward(model, data)
        mouth = data.site("human_mouth")
        tool = mouth.xmat.reshape(3, 3).T @ (data.site("robot_end_effector").xpos - mouth.xpos)
        middle, _, normal = places(jnp.array([number]), jnp.array([jaw]))
        np.testing.assert_allclose(tool, middle[0] + OFF * normal[0], atol=5e-3)
        assert min((contact.dist for contact in data.contact), default=0.0) > -0.003


class Table(LaidOut):
    """One simulation of the task, whose readings a test lays out by hand."""

    def __init__(self, preference: str = "p5", place: int = 1) -> None:
        super().__init__(TASK, preference)
        zero, nought = jnp.zeros(1, jnp.float32), jnp.zeros(1, jnp.int32)
        self.state: BrushState = dataclasses.replace(
            self.begun, place=nought + place, done=nought, strokes=nought, well=nought,
            side=zero + 1.0, time=zero, liked=zero, left=zero + jnp.nan,
        )  # fmt: skip

    def play(
        self, at: float, force: float = 2.0, steps: int = 1, aside: float = 0.0,
        jaw: float | None = None, yaw: float | None = None, struck: bool = False,
    ) -> dict[str, float]:  # fmt: skip
        """Return the weighted terms, summed over equal steps with the brush `at` m on the row."""
        place = int(self.state.place[0])
        jaw = (OPENED if INNER[place] else 0.0) if jaw is None else jaw
        yaw = TURNED * SHOWN_BY[place] if yaw is None else yaw
        middle, along, normal = places(jnp.array([place]), jnp.array([jaw]))
        row = TEETH.index(f"{ORDER[place][0]}_{ORDER[place][1]}_teeth")
        readings = dataclasses.replace(
            self.read,
            bowl=middle + at * along + (OFF + aside) * normal,
            jaw=jnp.array([jaw], jnp.float32),
            # The column of the neck's yaw, which the task alone knows.
            human_position=self.read.human_position.at[:, self.task._read_yaw].set(yaw),
            felt=jnp.zeros((1, len(TEETH))).at[:, row].set(force),
            tool_velocity=jnp.zeros((1, 3)),
            force=jnp.array([force], jnp.float32),
            on_arm=jnp.array([force], jnp.float32),
            struck=jnp.array([struck]),
        )
        return self.after(readings, steps)

    def stroke(self, steps: int, force: float = 2.0, **other: float) -> dict[str, float]:
        """Go to the end that comes next, in so many steps."""
        side = float(self.state.side[0])
        begin = self.play(-side * HALF, force, steps - 1, **other)
        end = self.play(side * HALF, force, **other)
        return {name: begin[name] + end[name] for name in begin}


def best_pay(table: Table) -> float:
    """Return the pay of a stroke as it is liked best: the steps that it should take."""
    return STROKE / table.preference.speed / 0.02


def liked_steps(table: Table) -> int:
    return round(best_pay(table))


@pytest.mark.slow
def test_four_strokes_finish_a_place() -> None:
    table = Table()
    steps = liked_steps(table)
    for count in range(STROKES):
        assert int(table.state.strokes[0]) == count
        paid = table.stroke(steps)
        assert paid["stroke"] == pytest.approx(best_pay(table), rel=0.02)
        assert paid["place"] == (10.0 if count == STROKES - 1 else 0.0)
    assert int(table.state.place[0]) == 2 and int(table.state.done[0]) == 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"force": 0.05},  # barely touches
        {"force": 12.0},
        {"aside": 0.01},  # off the teeth
        {"aside": -0.02},  # on the other side of them
        {"place": 0, "yaw": 0.0},  # a side that is not shown
        {"place": 7, "jaw": 0.1},  # the inside of a mouth that is shut
    ],
)
def test_what_is_no_stroke(wrong: dict[str, Any]) -> None:
    wrong = dict(wrong)
    table = Table(place=wrong.pop("place", 1))
    for _ in range(3):
        assert table.stroke(12, **wrong)["stroke"] == 0.0
    assert int(table.state.strokes[0]) == 0


def test_unpreferred_strokes_finish_a_place_that_pays_nothing() -> None:
    """When a place is done tells nobody what is liked: four strokes, whatever they were."""
    table = Table()
    paid = [table.stroke(2, force=7.0) for _ in range(STROKES)]
    assert int(table.state.done[0]) == 1 and int(table.state.liked_places[0]) == 0
    assert sum(terms["place"] for terms in paid) == 0.0
    assert sum(terms["stroke"] for terms in paid) < 0.06 * STROKES * best_pay(table)


@pytest.mark.parametrize(("liked", "counts"), [(WELL - 1, False), (WELL, True)])
def test_place_counts_after_enough_liked_strokes(liked: int, counts: bool) -> None:
    table = Table()
    for _ in range(STROKES - liked):
        table.stroke(2, force=7.0)
    # Off the teeth for longer than the 0.3 s over which a touch is smoothed.
    table.play(0.0, 0.0, steps=20, aside=0.03)
    for _ in range(liked):
        table.stroke(liked_steps(table))
    assert int(table.state.done[0]) == 1
    assert int(table.state.liked_places[0]) == counts


def test_stroke_takes_time_at_its_place_alone() -> None:
    """Who waits for a head that turns does not spoil the first stroke."""
    table = Table()
    table.play(0.0, 0.0, steps=60, aside=0.03)
    pay = table.stroke(liked_steps(table))["stroke"]
    assert pay == pytest.approx(best_pay(table), rel=0.02)


def test_standing_still_or_half_a_stroke_earns_nothing() -> None:
    table = Table()
    table.play(0.0)
    assert table.play(0.0, steps=200)["stroke"] == 0.0
    swings = [table.play(at)["stroke"] for at in (0.003, -0.003) * 20]
    assert sum(swings) == 0.0


@pytest.mark.parametrize("name", ["p1", "p5", "p9"])
def test_force_and_speed_pay_by_preference(name: str) -> None:
    by_force, by_steps = {}, {}
    likes = PREFERENCES[name]
    for force in PRESSES:
        table = Table(name)
        by_force[force] = table.stroke(liked_steps(table), force)["stroke"]
    for speed in SPEEDS:
        table = Table(name)
        by_steps[speed] = table.stroke(round(STROKE / speed / 0.02), likes.press)["stroke"]
    assert max(by_force, key=lambda force: by_force[force]) == likes.press
    assert max(by_steps, key=lambda speed: by_steps[speed]) == likes.speed
    least, best = min(*by_force.values(), *by_steps.values()), by_force[likes.press]
    pay = best_pay(Table(name))
    assert least >= pay * WHATEVER and best == pytest.approx(pay, rel=0.02)
    # Twice or half of the wish earns a fifth: who does not listen earns little.
    assert sorted(by_force.values())[1] < 0.25 * best
    assert sorted(by_steps.values())[1] < 0.25 * best


def test_a_perfect_episode_earns_the_bound() -> None:
    """For strokes the steps that they should take, for places 10, and for ways 50 a metre.

    Of a stroke at most a quarter of its length; between two places what is left after the first.
    """
    table = Table(place=0)
    steps, ways, between = liked_steps(table), 0.0, 0.0
    for _ in range(PLACES):
        for _ in range(STROKES):
            ways += table.stroke(steps)["progress"]
        between += float(table.state.left[0])
    assert int(table.state.done[0]) == PLACES
    bound = PLACES * (STROKES * best_pay(table) + 10.0)
    assert table.total - ways == pytest.approx(bound, rel=0.02)
    assert ways <= table.task.weights["progress"] * (0.5 * HALF * PLACES * STROKES + between)
    before = table.total
    for _ in range(4):
        table.stroke(steps)
    assert table.total == pytest.approx(before, abs=1e-3)  # a thirteenth place there is not


def test_six_places_are_success_unless_something_hurt() -> None:
    for struck in (False, True):
        table = Table()
        table.play(0.0, struck=struck)
        for count in range(ASKED * STROKES):
            table.stroke(liked_steps(table))
            assert bool(table.measures.success[0]) == (count == ASKED * STROKES - 1 and not struck)


def test_going_to_and_fro_earns_nothing() -> None:
    table = Table()
    ways = [0.05, 0.1, 0.02, 0.07, 0.05]
    assert sum(table.play(0.0, 0.0, aside=way)["progress"] for way in ways) == pytest.approx(
        0.0, abs=1e-4
    )


@pytest.mark.slow
def test_scripted_pair_brushes_better_than_idle_human() -> None:
    env = environment(TASK, "fused")
    _, states = meal(env, 32, 1000)
    assert np.asarray(states.terminated).any(axis=0).mean() < 0.1
    assert float(states.task.done[-1].mean()) > 2.5
    _, idle = meal(env, 32, 1000, human=lambda obs: jnp.zeros((obs.shape[0], 5)))
    assert not bool(idle.measures.success.any())
    assert int(idle.task.done.max()) <= 3
