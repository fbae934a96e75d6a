"""One law of care for all gentle tasks: liking, smoothing, discomfort, violations, caring success.

Expected values are computed by hand from what docs/tasks.md says.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params
from assistax_envs.models.care_scenes import FACE, TEETH
from assistax_envs.physics.base import felt_sensors
from assistax_envs.preferences import PREFERRED, WIDTH
from assistax_envs.tasks import care
from assistax_envs.tasks.care import IMPACT, NONE, PRESSED, Care
from assistax_envs.tasks.gentle_base import Preferences, TouchReadings
from assistax_envs.tasks.gentle_rules import IMPACT_LIMITS, LIMITS
from tests.envs.conftest import environment, one_gentle_task

LIKES = {
    "force": 4.0, "speed": 0.05, "distance": 0.25, "place": 0.2, "wait": 0.08, "depth": 0.02,
    "press": 2.0, "tolerance": 2.5,
}  # fmt: skip
UNIT = 4.0  # N: this person is hurt from 10 N on
STEP = 0.02  # s
AFTER = jax.jit(care.after, static_argnames="task")
FIELDS = [field.name for field in dataclasses.fields(TouchReadings)]


class Felt:
    """What one person feels of touches that a test makes up."""

    def __init__(self, task: str = "gentle_scratch", width: float | None = None) -> None:
        params = disability_params(["d1"])
        if width is not None:
            params = dataclasses.replace(params, width=jnp.array([width]))
        self.task, self.wishes = task, PREFERRED[task]
        self.care: Care = jax.vmap(lambda one: care.untouched(task, one))(params)
        self.likes = Preferences(**{name: jnp.array([like]) for name, like in LIKES.items()})

    def feel(
        self,
        done: dict[str, float] | None = None,
        steps: int = 1,
        force: float = 0.0,
        hurt: bool = False,
        struck: bool = False,
    ) -> Care:
        """Feel equal steps of a force of all touches, N; wishes not in `done` are not judged."""
        done = done or {}
        read = TouchReadings(**dict.fromkeys(FIELDS, jnp.zeros(1)))
        read = dataclasses.replace(
            read, force=jnp.array([force]), hurt=jnp.array([hurt]), struck=jnp.array([struck])
        )
        sample = tuple(jnp.array([done.get(name, 99.0)]) for name in self.wishes)
        judged = tuple(jnp.array([name in done]) for name in self.wishes)
        for _ in range(steps):
            self.care = AFTER(self.care, self.task, self.likes, read, sample, judged, UNIT)
        return self.care


# Liking.


@pytest.mark.parametrize(
    ("ratio", "expected"),
    [(1.0, 1.0), (1.5, 0.5112), (2.0, 0.1408), (2.5, 0.0325), (3.0, 0.0073), (0.0, 0.0)],
)
def test_liking_falls_with_the_logarithm_of_the_ratio(ratio: float, expected: float) -> None:
    best, width = jnp.array([0.05, 4.0]), jnp.array(WIDTH)
    np.testing.assert_allclose(care.liked(ratio * best, best, width), expected, atol=1e-4)
    if ratio:  # half is liked as little as twice
        np.testing.assert_allclose(care.liked(best / ratio, best, width), expected, atol=1e-4)


def test_training_may_begin_with_a_wider_liking() -> None:
    wide = Felt(width=0.7).care.width
    twice = care.liked(jnp.array([8.0]), jnp.array([4.0]), wide)
    np.testing.assert_allclose(twice, [0.6125], atol=1e-4)
    np.testing.assert_allclose(Felt().care.width, [0.35])


def test_within_is_a_factor_of_one_and_a_half() -> None:
    best = jnp.full(6, 4.0)
    done = best * jnp.array([1.0, 1.49, 1.51, 1 / 1.49, 1 / 1.51, 0.0])
    assert care.within(done, best).tolist() == [True, True, False, True, False, False]


def test_what_nobody_likes_earns_near_nothing() -> None:
    np.testing.assert_allclose(care.paid(jnp.array([0.0, 0.5, 1.0])), [0.05, 0.525, 1.0])


def test_touch_is_judged_by_its_smoothed_value() -> None:
    felt = Felt()
    felt.feel(steps=5, force=2.0)
    assert felt.care.done.tolist() == [[0.0, 0.0]] and not bool(felt.care.judged.any())
    felt.feel({"force": 2.0})
    np.testing.assert_allclose(felt.care.done, [[2.0, 0.0]])  # the first sample counts whole
    felt.feel({"force": 8.0}, steps=15)
    risen = 8.0 - 6.0 * (1.0 - STEP / 0.3) ** 15
    np.testing.assert_allclose(felt.care.done, [[risen, 0.0]], rtol=1e-5)
    assert felt.care.judged.tolist() == [[True, False]]
    felt.feel(steps=50)
    np.testing.assert_allclose(felt.care.done, [[risen, 0.0]], rtol=1e-5)  # nothing was judged
    felt.feel({"force": 1.0})
    np.testing.assert_allclose(felt.care.done, [[1.0, 0.0]])  # another touch


def test_tool_that_bounces_is_one_touch() -> None:
    """Lifting for a moment does not make the next sample count whole."""
    felt = Felt()
    felt.feel({"force": 2.0}, steps=30)
    felt.feel(steps=3)
    felt.feel({"force": 8.0})
    np.testing.assert_allclose(felt.care.done[:, 0], [2.0 + 6.0 * STEP / 0.3], rtol=1e-5)


# Discomfort.


@pytest.mark.parametrize(
    ("task", "done", "force", "expected"),
    [
        ("gentle_scratch", {"force": 9.0}, 9.0, 0.0),
        ("gentle_scratch", {"force": 15.0}, 15.0, 0.5),
        ("gentle_scratch", {}, 15.0, 0.5),  # of all touches, whatever is judged
        ("gentle_scratch", {"force": 99.0}, 99.0, 2.0),
        ("gentle_scratch", {"speed": 0.125}, 4.0, 0.25),
        ("gentle_scratch", {"speed": 0.09}, 4.0, 0.0),
        ("gentle_scratch", {"speed": 0.001}, 4.0, 0.0),  # slow is dull, and does not hurt
        ("gentle_scratch", {"speed": 0.125}, 15.0, 0.5),  # the worst counts, not the sum
        ("gentle_bath", {"speed": 0.15}, 4.0, 0.5),
        ("gentle_lift", {"distance": 0.0625}, 0.0, 1.0),
        ("gentle_lift", {"distance": 0.2}, 0.0, 0.0),
        ("gentle_lift", {"distance": 2.5}, 0.0, 0.0),
        ("gentle_lift", {"place": 2.0}, 0.0, 0.0),
        ("gentle_feeding", {"wait": 0.032}, 0.0, 0.25),
        ("gentle_feeding", {"wait": 0.2}, 0.0, 0.0),
        ("gentle_feeding", {"depth": 0.04}, 0.0, 0.25),
        ("gentle_feeding", {"depth": 0.005}, 0.0, 0.0),
        ("gentle_brushing", {"press": 8.0}, 8.0, 0.0),
        ("gentle_brushing", {"press": 12.0}, 12.0, 0.2),
    ],
)
def test_discomfort_is_the_worst_excess(
    task: str, done: dict[str, float], force: float, expected: float
) -> None:
    felt = Felt(task)
    felt.feel(done, steps=300, force=force)
    np.testing.assert_allclose(felt.care.discomfort, [expected], atol=1e-4)
    charged = care.costs(felt.care)
    np.testing.assert_allclose(charged["discomfort"], [-expected], atol=1e-4)
    assert bool(felt.care.felt[0]) == bool(done or force)
    felt.feel(steps=1)
    assert felt.care.discomfort.tolist() == [0.0] and felt.care.felt.tolist() == [False]


def test_touched_and_uneasy_steps_are_counted() -> None:
    felt = Felt()
    felt.feel(steps=7)
    felt.feel({"speed": 0.05}, steps=11, force=2.0)
    felt.feel({"speed": 0.15}, steps=40, force=2.0)
    # 0.15 - 0.1 * (14 / 15) ** k is first above 0.1 m/s after k = 11 steps.
    assert felt.care.touched.tolist() == [51] and felt.care.uneasy.tolist() == [30]


def test_unsteady_touch_is_charged() -> None:
    felt = Felt()
    felt.feel({"force": 4.0}, steps=20)
    assert value(care.costs(felt.care)["unsteady"]) == 0.0
    felt.feel({"force": 8.0})
    off = np.log(8.0 / (4.0 + 4.0 * STEP / 0.3))
    np.testing.assert_allclose(care.costs(felt.care)["unsteady"], [-(off**2)], rtol=1e-4)
    felt.feel({"force": 4000.0})
    assert value(care.costs(felt.care)["unsteady"]) == -1.0
    felt.feel()
    assert value(care.costs(felt.care)["unsteady"]) == 0.0


def value(array: jax.Array) -> float:
    return float(array.reshape(-1)[0])


# Violations.


@pytest.mark.parametrize("pause", [0, 1, 40])
def test_half_a_second_above_the_limit_adds_up(pause: int) -> None:
    """Pulses are no way around it: 25 steps above the limit are borne, and not one more."""
    felt = Felt()
    for _ in range(5):
        felt.feel(steps=5, hurt=True)
        felt.feel(steps=pause)
    assert felt.care.violation.tolist() == [NONE] and bool(felt.care.kept[0])
    felt.feel(hurt=True)
    assert felt.care.violation.tolist() == [PRESSED] and not bool(felt.care.kept[0])
    felt.feel(steps=100)
    felt.feel(hurt=True, struck=True)
    assert felt.care.violation.tolist() == [PRESSED]  # the first stays


def test_impact_is_a_violation_at_once() -> None:
    felt = Felt()
    felt.feel(hurt=True, struck=True)
    assert felt.care.violation.tolist() == [IMPACT] and felt.care.violated.tolist() == [True]
    felt.feel(steps=60, hurt=True)
    assert felt.care.violation.tolist() == [IMPACT]


def test_impacts_may_be_twice_as_hard_except_at_the_face() -> None:
    face = {"human_head", *FACE[1:], *(f"human_{part}" for part in TEETH)}
    assert set(IMPACT_LIMITS) == set(LIMITS) > face
    times = {part: IMPACT_LIMITS[part] / LIMITS[part] for part in LIMITS}
    assert times == {part: 1.0 if part in face else 2.0 for part in LIMITS}


@one_gentle_task
def test_readings_tell_impacts_from_pressing(task: str) -> None:
    """One contact at 0.9, 1.5 and 2.1 times the limit of each part, all other contacts without."""
    env: Any = environment(task, "native")
    sensors = [env.model.sensor(index) for index in felt_sensors(env.model)]
    parts = [env.model.geom(int(sensor.refid[0])).name for sensor in sensors]
    limits = np.array([LIMITS[part] for part in parts])
    for share in (0.9, 1.5, 2.1):
        values = np.zeros((len(parts), env.model.nsensordata + len(parts) + 1), np.float32)
        values[range(len(parts)), env.model.nsensordata + np.arange(len(parts))] = share * limits
        # Readings of values that are made by hand.
        read = env._sensors.read(jnp.asarray(values))
        assert read.hurt.tolist() == [share > 1.0] * len(parts)
        at_face = [IMPACT_LIMITS[part] == LIMITS[part] for part in parts]
        assert read.struck.tolist() == [share > (1.0 if face else 2.0) for face in at_face]


# Caring success.


@pytest.mark.parametrize(
    ("goal", "uneasy", "hurt", "cares"),
    [
        (True, 0, 0, True),
        (True, 20, 25, True),  # trying is allowed
        (True, 21, 0, False),
        (True, 0, 26, False),
        (False, 0, 0, False),
    ],
)
def test_caring_success_needs_goal_comfort_and_no_violation(
    goal: bool, uneasy: int, hurt: int, cares: bool
) -> None:
    felt = Felt()
    felt.feel({"speed": 0.05}, steps=100 - uneasy, force=2.0)
    now = dataclasses.replace(felt.care, touched=jnp.array([100]), uneasy=jnp.array([uneasy]))
    felt.care = now
    felt.feel(steps=hurt, hurt=True)
    read = TouchReadings(**dict.fromkeys(FIELDS, jnp.zeros(1)))
    read = dataclasses.replace(read, tool_velocity=jnp.zeros((1, 3)))
    wishes = felt.likes.of(felt.task)
    seen = care.measures(felt.care, read, jnp.zeros(1), jnp.array([goal]), wishes)
    assert seen.success.tolist() == [cares]
    assert seen.liked is not None
    np.testing.assert_allclose(seen.liked, [[4.0, 0.05]])
    assert seen.violation is not None and seen.violation.tolist() == [PRESSED if hurt > 25 else 0]
