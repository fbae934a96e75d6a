"""Gentle wave: the tool strokes the forearm from end to end, at the preferred force and speed."""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks import care
from assistax_envs.tasks.base import (
    LOWER_ARM,
    ROBOT_READY,
    Measures,
    Pose,
    observations,
    rotate,
    segment_points,
)
from assistax_envs.tasks.gentle_base import (
    FELT,
    ROUGHNESS,
    STEP,
    Preferences,
    TouchReadings,
    TouchSensors,
    episode_preferences,
    roughness,
    with_preference,
)

HALF = 0.05  # m, from the forearm's middle to either end of a stroke
ANGLE = np.deg2rad(42.0)  # of the stroked line about the forearm's axis
NEAR = 0.02  # m, from the tool to an end that it has reached
# Strokes that are success, if at least half of the steps on the skin were as liked.
ENOUGH, MOSTLY = 4, 0.5
START = ROBOT_READY | {  # rad: the forearm lies over its trough
    "human_right_shoulder1": (0.0, -0.02, 0.02),
    "human_right_shoulder2": (-0.6, -0.02, 0.02),
    "human_right_elbow": (-0.36, 0.0, 0.1),
}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class WaveState:
    """Progress of the strokes, [N] each."""

    side: jax.Array  # +1 or -1: the end that the tool goes to
    distance: jax.Array  # m, to that end a step ago, NaN before the first step
    touched: jax.Array  # steps of this stroke on the skin
    liked: jax.Array  # steps of them within 1.5 of the liked force and speed
    strokes: jax.Array  # int32, done as liked
    care: care.Care
    preference: Preferences


class GentleWave:
    """Pays progress to an end, most of all on the skin at the preferred force and speed."""

    name = scene = "gentle_wave"
    stops: ClassVar = True
    target_colours: ClassVar = {"ends": (0.05, 0.20, 0.75, 1.0)}

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        told: tuple[str, ...] = ("human",),
    ) -> None:
        """Prepare.

        Args:
            model: The scene.
            weights: Weights of reward terms that replace the task's own.
            told: Roles that observe the preference.
        """
        own = {"progress": 5.0, "stroke": 1.0} | ROUGHNESS | care.COSTS
        self.weights = own | {"violation": 20.0} | (weights or {})
        self.pose = Pose(model, START)
        self.sensors = TouchSensors(model, self.pose)
        self._told = told
        radius = model.site("human_right_lower_arm").size[0]
        outward = np.array([np.cos(ANGLE), np.sin(ANGLE), 0.0], np.float32)
        self._outward, self._line = outward, radius * outward

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, WaveState]:
        """Draw the start pose [nq], the first end and, unless it is given, the preference."""
        pose_key, side_key, preference_key = jax.random.split(key, 3)
        state = WaveState(
            side=jnp.where(jax.random.bernoulli(side_key), 1.0, -1.0),
            distance=jnp.full((), jnp.nan, jnp.float32),
            touched=jnp.zeros((), jnp.float32),
            liked=jnp.zeros((), jnp.float32),
            strokes=jnp.zeros((), jnp.int32),
            care=care.untouched(self.scene, params),
            preference=episode_preferences(params, preference_key),
        )
        return self.pose.draw(pose_key), state

    def targets(self, task_state: WaveState, readings: TouchReadings) -> dict[str, jax.Array]:
        """Return the positions of both ends, [N, 2, 3]."""
        side = task_state.side
        ends = [self._end(readings, jnp.full_like(side, end)) for end in (1.0, -1.0)]
        return {"ends": jnp.stack(ends, axis=1)}

    def transition(
        self, task_state: WaveState, readings: TouchReadings
    ) -> tuple[WaveState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds after enough strokes as liked, with care."""
        s, r = task_state, readings
        distance = jnp.linalg.norm(self._end(r, s.side) - r.tool_position, axis=-1)
        progress = jnp.where(jnp.isnan(s.distance), 0.0, s.distance - distance)
        touching = r.on_arm > FELT
        sample = r.on_arm, jnp.maximum(progress, 0.0) / STEP
        given = s.care, self.scene, s.preference, r
        felt = care.after(*given, sample, (touching, touching), s.preference.force)
        best = s.preference.of(self.scene)
        liked = care.liked(felt.done, best, felt.width[:, None]).prod(axis=1)
        terms = {"progress": progress, "stroke": touching * care.paid(liked)}
        terms |= roughness(r, felt.violated) | care.costs(felt)
        touched = s.touched + touching
        well = s.liked + (touching & care.within(felt.done, best).all(axis=1))
        arrived = touching & (distance < NEAR)
        side = jnp.where(arrived, -s.side, s.side)
        towards = self._end(r, side) - r.tool_position
        left = jnp.linalg.norm(towards, axis=-1)
        after = WaveState(
            side=side,
            distance=left,
            touched=jnp.where(arrived, 0.0, touched),
            liked=jnp.where(arrived, 0.0, well),
            strokes=s.strokes + (arrived & (well >= MOSTLY * touched)),
            care=felt,
            preference=s.preference,
        )
        outward = jnp.broadcast_to(self._outward, towards.shape)
        outward = rotate(r.arm_orientation[:, LOWER_ARM], outward)
        # Nothing here tells the robot what is liked: neither the count of strokes nor discomfort.
        goal = towards, left[:, None], outward, r.force[:, None] / 10.0
        obs = with_preference(
            observations(r, *goal),
            care.felt_by(felt, self.scene),
            s.preference.observed(self.scene),
            self._told,
        )
        done = after.strokes >= ENOUGH
        return after, obs, terms, care.measures(felt, r, distance, done, best)

    def _end(self, r: TouchReadings, side: jax.Array) -> jax.Array:
        """Return the position [N, 3] of the end on a side [N]."""
        along = jnp.asarray([0.0, 0.0, HALF])[None] * side[:, None]
        segment = jnp.full(side.shape, LOWER_ARM)
        return segment_points(r, segment, jnp.asarray(self._line)[None] + along)
