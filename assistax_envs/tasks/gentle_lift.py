"""Gentle lift: the hanging forearm is brought beside the waist, and rests once the hook let go.

Neither can do it alone: the human is too weak to lift its arm, and an arm that nobody holds slides
off the bed.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco

from assistax_envs.tasks.arm_assist import LOWER_ARM, START
from assistax_envs.tasks.base import Measures, Pose, observations, to_target
from assistax_envs.tasks.gentle_base import (
    COSTS,
    FELT,
    HARD,
    LIGHTEST,
    STEP,
    Liking,
    TouchReadings,
    TouchSensors,
    bump,
    costs,
    liking,
    with_preference,
)

WAIST = (
    -0.17,
    -0.26,
    0.77,
)  # m: across the waist, by the bed's edge; an idle arm slides off it by 20 cm
THERE = 0.06  # m
CALM = 0.1  # m/s
FAR = 0.25  # m from the waist: nearer, the hook's way to the arm is no longer paid for
HOLD = 100  # steps of rest that are success: 2 s
SWING = 0.4  # m/s of the forearm that costs nothing yet
SOFT = 40.0  # N, the sum over the hook: a forearm and hand weigh 15 N
WIDE = 0.08  # m, how the pay for being there falls off
CARRY_FORCE, CARRY_SPEED = 5.0, 4.0  # of a carry: so many times the force and the speed of a touch
WHATEVER = 0.2  # share of the pay for resting there that no liking of the carry changes


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LiftState:
    """How far the forearm is, and how long it has rested."""

    waist: jax.Array  # [3] target, m
    section: jax.Array  # [3] middle of the forearm a step ago; NaN before the first step
    left: jax.Array  # m, from it to the target a step ago
    distance: jax.Array  # m, from the hook to it a step ago
    carried: jax.Array  # m, of the forearm towards the target, in the hook
    liked: jax.Array  # m, of it as the human likes it
    held: jax.Array  # int32, steps of rest in a row
    longest: jax.Array  # int32
    violated: jax.Array  # bool, some contact was above the hard limit
    likes: Liking


class GentleLift:
    """Progress of the forearm to the waist and of the hook to it; pay for being there.

    Most of it without a touch.
    """

    name = "gentle_lift"
    target_colours: ClassVar = {
        "section": (0.95, 0.05, 0.55, 1.0),
        "waist": (0.10, 0.35, 0.95, 1.0),
    }

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        told: tuple[str, ...] = ("human",),
    ) -> None:
        terms = {"approach": 10.0, "lift": 100.0, "there": 0.3, "rest": 1.0, "swing": 0.1}
        # A hook that carries touches more than the bar.
        self.weights = terms | COSTS | {"stray": 0.0, "violation": 10.0} | (weights or {})
        self.pose = Pose(model, START)
        self.sensors = TouchSensors(model, self.pose)
        self._told = told

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, LiftState]:
        """Draw the start pose [nq] and, where it is not given, the preference."""
        pose_key, likes_key = jax.random.split(key)
        nan, zero = jnp.full((), jnp.nan, jnp.float32), jnp.zeros((), jnp.int32)
        state = LiftState(
            waist=jnp.asarray(WAIST, jnp.float32),
            section=jnp.full(3, jnp.nan, jnp.float32),
            left=nan,
            distance=nan,
            carried=jnp.zeros((), jnp.float32),
            liked=jnp.zeros((), jnp.float32),
            held=zero,
            longest=zero,
            violated=jnp.zeros((), bool),
            likes=liking(params.preference, likes_key),
        )
        return self.pose.draw(pose_key), state

    def targets(self, task_state: LiftState, readings: TouchReadings) -> dict[str, jax.Array]:
        """See `Task.targets`: the section of the forearm, and where it should go."""
        section = readings.arm_position[:, LOWER_ARM]
        return {"section": section[:, None], "waist": task_state.waist[:, None]}

    def transition(
        self, task_state: LiftState, readings: TouchReadings
    ) -> tuple[LiftState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds after 2 s of rest.

        If none of the episode's contacts was hard.
        """
        s, r = task_state, readings
        section = r.arm_position[:, LOWER_ARM]
        towards, distance = to_target(section, r)
        lift = s.waist - section
        left = jnp.linalg.norm(lift, axis=-1)
        first = jnp.isnan(s.left)
        speed = jnp.linalg.norm(jnp.where(first[:, None], 0.0, section - s.section), axis=-1) / STEP
        rest = (left < THERE) & (speed < CALM) & (r.force < LIGHTEST)
        way = jnp.where(first | (r.force < FELT), 0.0, jnp.maximum(s.left - left, 0.0))
        likes = s.likes
        fits = bump(r.force, CARRY_FORCE * likes.force) * bump(speed, CARRY_SPEED * likes.speed)
        carried, liked = s.carried + way, s.liked + way * fits
        content = WHATEVER + (1.0 - WHATEVER) * liked / jnp.maximum(carried, 0.05)
        terms = {
            "approach": jnp.where(first | (left < FAR), 0.0, s.distance - distance),
            "lift": jnp.where(first, 0.0, s.left - left),
            "there": jnp.exp(-((left / WIDE) ** 2)) * jnp.exp(-((speed / CALM) ** 2)),
            "rest": rest * content,
            "swing": -jnp.minimum(1.0, jnp.maximum(speed - SWING, 0.0) / SWING),
        } | costs(r, SOFT)
        held = jnp.where(rest, s.held + 1, 0)
        longest = jnp.maximum(s.longest, held)
        violated = s.violated | (r.peak > HARD)
        goal = (
            towards,
            distance[:, None],
            lift,
            left[:, None],
            r.force[:, None] / 10.0,
            jnp.minimum(held, HOLD)[:, None] / HOLD,
            speed[:, None] * 10.0,
            content[:, None],
        )
        obs = with_preference(observations(r, *goal), s.likes, self._told)
        state = LiftState(
            s.waist, section, left, distance, carried, liked, held, longest, violated, s.likes
        )
        done = (longest >= HOLD) & ~violated
        return state, obs, terms, Measures(r.force, left, done, r.peak, violated)
