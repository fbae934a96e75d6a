"""Gentle lift: the hanging forearm is brought beside the waist, and rests once the hook let go.

Neither can do it alone: the human is too weak to lift its arm, and an arm that is not held slides
off the bed. Once it rests, the hook waits at the distance that the human likes.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks import care
from assistax_envs.tasks.arm_assist.task import START
from assistax_envs.tasks.base import (
    HUMAN_ACTUATORS,
    LOWER_ARM,
    Measures,
    Pose,
    observations,
    rotate,
    to_target,
)
from assistax_envs.tasks.gentle_base import (
    LIGHTEST,
    ROUGHNESS,
    STEP,
    Preferences,
    TouchReadings,
    TouchSensors,
    episode_preferences,
    roughness,
    with_preference,
)
from assistax_envs.tasks.gentle_lift.person import ACROSS, MIDDLE
from assistax_envs.tasks.person_numbers import FOREARM

# m: the preferred place of the forearm lies across the waist from here. Everywhere there an arm
# that is not held slides off the body by 7 to 13 cm. A weak human can let it slide down the
# waist to its place (from 0.3 to 0.2 or 0.1), and cannot draw it up.
EDGE = (-0.338, -0.382, 0.765)
# rad: shoulder 1, shoulder 2, elbow of an arm that is rolled onto the bed and bent. Episodes start
# anywhere between, as if it had slipped so far. Teams that always start with the whole way find its
# first half, and stay there: docs/log/gentle_tasks.md.
WAY = (
    (-0.92, -0.97, -1.57),
    (-0.74, -1.02, -1.57),
    (-0.48, -1.05, -1.57),
    (-0.22, -1.04, -1.57),
    (0.02, -1.01, -1.57),
    (0.22, -0.95, -1.57),
    (0.38, -0.88, -1.57),
    (0.53, -0.80, -1.57),
    (0.54, -0.79, -1.33),
    (0.54, -0.79, -1.09),
    (0.54, -0.79, -0.85),
    (0.54, -0.79, -0.60),
    (0.54, -0.79, -0.25),
    (0.62, -0.76, -0.42),
    (0.73, -0.73, -0.59),
)
# m: where a bar lifts the forearm, from its middle towards the hand (with the lever of the whole
# arm below the elbow) and down (its own and the arm's radius).
HANDWARD, UNDER = 0.08, 0.045
THERE = 0.06  # m
CALM = 0.1  # m/s
HOLD = 100  # steps of rest that are success: 2 s
SWING = 0.4  # m/s of the forearm that costs nothing yet
SOFT = 40.0  # N, the sum over the hook: a forearm and hand weigh 15 N
WIDE = 0.08  # m, how the pay for being there falls off


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LiftState:
    """Place of the forearm, and the time for which it has rested."""

    waist: jax.Array  # [3] preferred place of the forearm, m
    section: jax.Array  # [3] middle of the forearm a step ago; NaN before the first step
    left: jax.Array  # m, from it to the target a step ago
    under: jax.Array  # m, from the hook to where it lifts the forearm, a step ago
    held: jax.Array  # int32, steps of rest in a row, with the hook at the liked distance
    longest: jax.Array  # int32
    care: care.Care
    preference: Preferences


class GentleLift:
    """Progress of the hook under the forearm, and of that to the waist; pay for being there.

    Resting without a touch pays most, with the hook at the preferred distance.
    """

    name = scene = "gentle_lift"
    stops: ClassVar = True
    target_colours: ClassVar = {
        "section": (0.95, 0.05, 0.55, 1.0),
        "waist": (0.05, 0.20, 0.75, 1.0),
    }

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        told: tuple[str, ...] = ("human",),
    ) -> None:
        terms = {"approach": 10.0, "lift": 100.0, "there": 0.3, "rest": 1.0, "swing": 0.1}
        # A hook that carries touches more than the bar.
        self.weights = terms | ROUGHNESS | care.COSTS
        self.weights |= {"stray": 0.0, "violation": 20.0} | (weights or {})
        self.pose = Pose(model, START)
        self.sensors = TouchSensors(model, self.pose)
        self._told = told
        joints = [model.joint(name) for name in HUMAN_ACTUATORS]
        self._arm = np.array([joint.qposadr[0] for joint in joints])

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, LiftState]:
        """Draw the start pose [nq] and, unless it is given, the preference."""
        pose_key, preference_key, start_key = jax.random.split(key, 3)
        nan, zero = jnp.full((), jnp.nan, jnp.float32), jnp.zeros((), jnp.int32)
        preference = episode_preferences(params, preference_key)
        state = LiftState(
            waist=_place(preference.place),
            section=jnp.full(3, jnp.nan, jnp.float32),
            left=nan,
            under=nan,
            held=zero,
            longest=zero,
            care=care.untouched(self.scene, params),
            preference=preference,
        )
        return self._slipped(self.pose.draw(pose_key), start_key), state

    def targets(self, task_state: LiftState, readings: TouchReadings) -> dict[str, jax.Array]:
        """See `Task.targets`: the section of the forearm, and where it should go."""
        section = readings.arm_position[:, LOWER_ARM]
        return {"section": section[:, None], "waist": task_state.waist[:, None]}

    def transition(
        self, task_state: LiftState, readings: TouchReadings
    ) -> tuple[LiftState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds after 2 s of rest at the liked distance."""
        s, r = task_state, readings
        section = r.arm_position[:, LOWER_ARM]
        towards, distance = to_target(section, r)
        lift = s.waist - section
        left = jnp.linalg.norm(lift, axis=-1)
        first = jnp.isnan(s.left)
        speed = jnp.linalg.norm(jnp.where(first[:, None], 0.0, section - s.section), axis=-1) / STEP
        rest = (left < THERE) & (speed < CALM) & (r.force < LIGHTEST)
        _, under = to_target(_lifted_at(section, r), r)
        felt = self._felt(s, r, section, distance, rest)
        liked = care.liked(felt.done[:, 0], s.preference.distance, felt.width)
        terms = {
            "approach": jnp.where(first | (left < THERE), 0.0, s.under - under),
            "lift": jnp.where(first, 0.0, s.left - left),
            "there": jnp.exp(-((left / WIDE) ** 2)) * jnp.exp(-((speed / CALM) ** 2)),
            "rest": rest * care.paid(liked),
            "swing": -jnp.minimum(1.0, jnp.maximum(speed - SWING, 0.0) / SWING),
        }
        terms |= roughness(r, felt.violated, SOFT) | care.costs(felt)
        liked_rest = rest & care.within(felt.done[:, 0], s.preference.distance)
        held = jnp.where(liked_rest, s.held + 1, 0)
        longest = jnp.maximum(s.longest, held)
        to_middle = _place(MIDDLE)[None] - section
        goal = (
            towards,
            distance[:, None],
            to_middle,
            jnp.linalg.norm(to_middle, axis=-1, keepdims=True),
            r.force[:, None] / 10.0,
            speed[:, None] * 10.0,
        )
        # The human alone feels whether the arm rests at its place.
        seen = jnp.column_stack([jnp.minimum(held, HOLD) / HOLD, s.preference.observed(self.scene)])
        obs = with_preference(
            observations(r, *goal), care.felt_by(felt, self.scene), seen, self._told
        )
        state = LiftState(s.waist, section, left, under, held, longest, felt, s.preference)
        best = s.preference.of(self.scene)
        return state, obs, terms, care.measures(felt, r, left, longest >= HOLD, best)

    def _felt(
        self,
        s: LiftState,
        r: TouchReadings,
        section: jax.Array,
        distance: jax.Array,
        rest: jax.Array,
    ) -> care.Care:
        """Return the care after a step: of the hook's distance and the arm's place at rest."""
        across = jnp.array([ACROSS], jnp.float32)
        place = ((section - jnp.array([EDGE], jnp.float32)) * across).sum(axis=-1)
        sample = distance, jnp.maximum(place / (across**2).sum(), 0.01)
        return care.after(s.care, self.scene, s.preference, r, sample, (rest, rest), FOREARM)

    def _slipped(self, pose: jax.Array, key: jax.Array) -> jax.Array:
        """Return the pose [nq] with the arm somewhere on its way."""
        way = jnp.asarray(WAY, jnp.float32)
        place = jax.random.uniform(key, maxval=len(WAY) - 1.0)
        arm = jnp.stack([jnp.interp(place, jnp.arange(len(WAY)), joint) for joint in way.T])
        return pose.at[self._arm].add(arm - self.pose.angle[self._arm])


def _place(across: jax.Array | float) -> jax.Array:
    """Return the place [3] that lies `across` m across the waist."""
    return jnp.array(EDGE, jnp.float32) + across * jnp.array(ACROSS, jnp.float32)


def _lifted_at(section: jax.Array, r: TouchReadings) -> jax.Array:
    """Return the points [N, 3] at which a bar lifts forearms with middles at `section` [N, 3]."""
    handward = jnp.broadcast_to(jnp.array([[0.0, 0.0, -HANDWARD]]), section.shape)
    return (section + rotate(r.arm_orientation[:, LOWER_ARM], handward)).at[:, 2].add(-UNDER)
