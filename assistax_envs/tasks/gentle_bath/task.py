"""Gentle bath: the underside of the arm is wiped in any order, at the liked force and speed.

The arm lies on the bed, and its upper side is clean. The human has to turn and lift it.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks import care
from assistax_envs.tasks.base import LOWER_ARM, Measures, Pose, observations, rotate
from assistax_envs.tasks.bed_bath.person import UNDERSIDE
from assistax_envs.tasks.bed_bath.task import START, arm_points
from assistax_envs.tasks.gentle_base import (
    FELT,
    ROUGHNESS,
    SOFT,
    STEP,
    Preferences,
    TouchReadings,
    TouchSensors,
    along_skin,
    episode_preferences,
    in_segment,
    roughness,
    with_preference,
)

# m from the middle of the pad, whose half length is 5.5 cm: a point under the pad is wiped
NEAR = 0.04
SLIDE = 0.02  # m/s over the skin, below which nothing is wiped
PRESS = 0.5  # N, likewise
# Steps that a point is wiped until it is clean. How well that is liked changes what it pays, not
# how long it takes: a robot that observed the rest of a point would be told.
DWELL = 50.0
# Points wiped as liked that are success, of the 12 on the forearm, which are all that is asked for.
# A human whose arm has half of its strength cannot show the upper arm's. A point counts if half of
# its wiping was within 1.5 of the liked force and speed.
ENOUGH, MOSTLY = 8, 0.5
# m above the skin, where the way to a point is measured to: points that face the pad come first
FACING = 0.03
# m that half a turn of the arm counts for in that way. The shortest way to a point on the far side
# leads through the arm: without this, teams wipe what one posture shows and never turn the arm.
TURN = 0.2
# Share of a step's speed in the smoothed one: over 0.2 s, so that trembling is no rubbing.
SMOOTH = 0.1
WIPED = 9.0  # m, a distance beyond all others


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class WipeState:
    """Points that are left, and the motion of the pad."""

    left: jax.Array  # [K] how much of a point is to be wiped: 1 at first, 0 once it is clean
    last: jax.Array  # [2, 3] tool a step ago in each segment's frame, m; NaN before the first step
    drift: jax.Array  # [2, 3] m/s, its smoothed velocity there
    nearest: jax.Array  # m, to the nearest point a step ago
    well: jax.Array  # [K] how much of a point was wiped as liked
    care: care.Care
    preference: Preferences


class GentleBath:
    """Progress to the nearest point, and pay for each point: by the force and the speed."""

    name = scene = "gentle_bath"
    stops: ClassVar = True
    target_colours: ClassVar = {"next": (0.95, 0.05, 0.55, 1.0), "to wipe": (0.05, 0.20, 0.75, 1.0)}

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        told: tuple[str, ...] = ("human",),
    ) -> None:
        terms = {"progress": 20.0, "wipe": 20.0}
        self.weights = terms | ROUGHNESS | care.COSTS | {"violation": 40.0} | (weights or {})
        self.pose = Pose(model, START)
        self.sensors = TouchSensors(model, self.pose)
        self._told = told
        self._segment, self._offset = underside(model)
        asked = self._segment == LOWER_ARM
        self._asked = np.array(asked, np.float32)  # [K]
        radial = self._offset * np.array([1.0, 1.0, 0.0], np.float32)
        self._outward = radial / np.linalg.norm(radial, axis=1, keepdims=True)
        self._over = self._offset + FACING * self._outward

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, WipeState]:
        """Draw the start pose [nq] and, unless it is given, the preference."""
        pose_key, preference_key = jax.random.split(key)
        nan = jnp.full((), jnp.nan, jnp.float32)
        state = WipeState(
            left=jnp.asarray(self._asked),
            last=jnp.full((2, 3), nan),
            drift=jnp.zeros((2, 3), jnp.float32),
            nearest=nan,
            well=jnp.zeros(len(self._asked), jnp.float32),
            care=care.untouched(self.scene, params),
            preference=episode_preferences(params, preference_key),
        )
        return self.pose.draw(pose_key), state

    def targets(self, task_state: WipeState, readings: TouchReadings) -> dict[str, jax.Array]:
        """See `Task.targets`: the points to wipe, and the one that is nearest."""
        points = self._points(readings, self._offset)
        left = task_state.left > 0
        nearest = jnp.where(left, _distance(points, readings), WIPED).argmin(axis=1)
        row = jnp.arange(left.shape[0])
        return {
            "to wipe": jnp.where(left[..., None], points, jnp.nan),
            "next": points[row, nearest][:, None],
        }

    def transition(
        self, task_state: WipeState, readings: TouchReadings
    ) -> tuple[WipeState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds once enough was wiped as liked."""
        s, r = task_state, readings
        points, over = self._points(r, self._offset), self._points(r, self._over)
        gap, first = _distance(points, r), jnp.isnan(s.nearest)
        tool, drift, speed = self._slide(s, r, gap, first)
        felt = self._felt(s, r, speed)
        way = _distance(over, r) + TURN * self._turned_away(tool)
        left = self._left(s, r, gap < NEAR, speed)
        wiped = (s.left - left).sum(axis=1)
        best = s.preference.of(self.scene)
        near = jnp.where(s.left > 0, way, WIPED).min(axis=1)
        liked = care.liked(felt.done, best, felt.width[:, None]).prod(axis=1)
        terms = {
            "progress": jnp.where(first | (near >= WIPED), 0.0, s.nearest - near),
            "wipe": wiped * care.paid(liked),
        }
        terms |= roughness(r, felt.violated) | care.costs(felt)
        well = s.well + (s.left - left) * care.within(felt.done, best).all(axis=1, keepdims=True)
        after = jnp.where(left > 0, way, WIPED)
        row, upcoming = jnp.arange(left.shape[0]), after.argmin(axis=1)
        nearest = after.min(axis=1)
        goal = (
            points[row, upcoming] - r.tool_position,
            (over - points)[row, upcoming] / FACING,  # its skin's normal
            nearest[:, None],
            r.force[:, None] / 10.0,
            speed[:, None] * 10.0,
            left,
        )
        obs = with_preference(
            observations(r, *goal),
            care.felt_by(felt, self.scene),
            s.preference.observed(self.scene),
            self._told,
        )
        state = WipeState(left, tool, drift, nearest, well, felt, s.preference)
        done = (well >= MOSTLY).sum(axis=1) >= ENOUGH
        return state, obs, terms, care.measures(felt, r, near, done, best)

    def _felt(self, s: WipeState, r: TouchReadings, speed: jax.Array) -> care.Care:
        """Return the care after a step: of the force, and of the speed of a pad that slides."""
        touching = r.on_arm > FELT
        sample, judged = (r.on_arm, speed), (touching, touching & (speed > SLIDE))
        given = s.care, self.scene, s.preference, r
        return care.after(*given, sample, judged, s.preference.force)

    def _left(
        self, s: WipeState, r: TouchReadings, under: jax.Array, speed: jax.Array
    ) -> jax.Array:
        """Return the rest of each point to wipe [N, K].

        `under` [N, K] has the points under the pad, `speed` [N] is that of the pad over the skin.
        """
        most = 2.0 * SOFT  # some people like 10 N
        gentle = (r.on_arm > PRESS) & (r.on_arm < most) & (speed > SLIDE)
        hit = under & (s.left > 0) & gentle[:, None]
        return jnp.maximum(s.left - hit / DWELL, 0.0)

    def _slide(
        self, s: WipeState, r: TouchReadings, gap: jax.Array, first: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return the tool in both segments' frames, its smoothed velocity there, its speed.

        [N, 2, 3] each, and [N] over the skin.
        """
        n = gap.shape[0]
        segments = (jnp.full(n, index, jnp.int32) for index in range(2))
        tool = jnp.stack([in_segment(r, segment, r.tool_position) for segment in segments], axis=1)
        step = jnp.where(first[:, None, None], 0.0, tool - s.last) / STEP
        drift = s.drift + SMOOTH * (step - s.drift)
        nearest = jnp.asarray(self._segment)[gap.argmin(axis=1)]
        return tool, drift, along_skin(drift, tool)[jnp.arange(n), nearest]

    def _turned_away(self, tool: jax.Array) -> jax.Array:
        """Return the share [N, K] by which points face away from the tool [N, 2, 3], 0 to 1."""
        at = tool[:, self._segment].at[..., 2].set(0.0)  # [N, K, 3], across the segment
        at = at / jnp.maximum(jnp.linalg.norm(at, axis=-1, keepdims=True), 1e-6)
        return 0.5 * (1.0 - (at * self._outward[None]).sum(axis=-1))

    def _points(self, r: TouchReadings, offset: np.ndarray) -> jax.Array:
        """Return the world positions [N, K, 3] of points [K, 3] in the segments' frames."""
        turn = r.arm_orientation[:, self._segment]
        return r.arm_position[:, self._segment] + rotate(
            turn, jnp.broadcast_to(offset, (*turn.shape[:2], 3))
        )


def underside(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the points to wipe: their segments [K], and offsets [K, 3] in their frames, m."""
    segment, offset = arm_points(model)
    low, high = np.array(UNDERSIDE)[segment].T
    angle = np.degrees(np.arctan2(offset[:, 1], offset[:, 0])) - low
    under = angle % 360.0 < high - low
    return segment[under], offset[under]


def _distance(points: jax.Array, r: TouchReadings) -> jax.Array:
    """Return the distances [N, K] of points [N, K, 3] from the tool, m."""
    return jnp.linalg.norm(points - r.tool_position[:, None], axis=-1)
