"""Scratch: the robot scratches a point on the human's right arm (paper, 3.1 and A)."""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks.base import (
    ARM_SEGMENTS,
    REACH,
    ROBOT_READY,
    Measures,
    Pose,
    Readings,
    Sensors,
    observations,
    reach_term,
    segment_points,
    to_target,
)

START = (
    ROBOT_READY
    | {  # joint -> (angle, lowest offset, highest offset), rad: forearm over its trough
        "human_right_shoulder1": (0.0, -0.02, 0.02),
        "human_right_shoulder2": (-0.6, -0.02, 0.02),
        "human_right_elbow": (-0.36, 0.0, 0.1),
    }
)
BEST_SPEED = 0.1  # m/s, v* of Table 5
BEST_FORCE = 3.0  # N, f* of Table 5


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ScratchState:
    """The itching point: fixed to one segment of the right arm for the whole episode."""

    segment: jax.Array  # int32 index into ARM_SEGMENTS
    offset: jax.Array  # [3] in the segment's frame, m


class Scratch:
    """Reach the target, then press and move.

    `exp(-d^2/sigma) + [d < 0.1] (v/v* e^(-v/v*)) (f/f* e^(-f/f*))`.
    """

    name = scene = "scratch"
    stops: ClassVar = False
    target_colours: ClassVar = {"itch": (0.95, 0.05, 0.55, 1.0)}  # of `targets`, RGBA

    def __init__(self, model: mujoco.MjModel, weights: dict[str, float] | None = None) -> None:
        self.weights = {"reach_target": 1.0, "scratch": 1.0} | (weights or {})
        self.pose, self.sensors = Pose(model, START), Sensors(model)
        sites = [model.site(f"human_{segment}") for segment in ARM_SEGMENTS]
        self._radius = np.array([site.size[0] for site in sites], np.float32)
        self._half_length = np.array([site.size[1] for site in sites], np.float32)

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, ScratchState]:
        """Draw the start pose [nq] and a target uniform over the skin of upper and lower arm."""
        del params
        pose_key, segment_key, along_key, around_key = jax.random.split(key, 4)
        area = self._radius * self._half_length
        segment = jax.random.categorical(segment_key, jnp.log(area)).astype(jnp.int32)
        along = (
            jax.random.uniform(along_key, minval=-1.0, maxval=1.0)
            * jnp.asarray(self._half_length)[segment]
        )
        angle = jax.random.uniform(around_key, maxval=2.0 * jnp.pi)
        around = jnp.asarray(self._radius)[segment] * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        return self.pose.draw(pose_key), ScratchState(segment, jnp.append(around, along))

    def targets(self, task_state: ScratchState, readings: Readings) -> dict[str, jax.Array]:
        """See `Task.targets`: the itch."""
        return {"itch": segment_points(readings, task_state.segment, task_state.offset)[:, None]}

    def transition(
        self, task_state: ScratchState, readings: Readings
    ) -> tuple[ScratchState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`.

        The goal holds while the tool touches the arm within reach of the target.
        """
        towards, distance = to_target(
            segment_points(readings, task_state.segment, task_state.offset), readings
        )
        force = jnp.linalg.norm(readings.tool_force, axis=-1)
        terms = scratch_terms(distance, jnp.linalg.norm(readings.tool_velocity, axis=-1), force)
        measures = Measures(force, distance, (distance < REACH) & (force > 0.0))
        return task_state, observations(readings, towards, distance[:, None]), terms, measures


def scratch_terms(distance: jax.Array, speed: jax.Array, force: jax.Array) -> dict[str, jax.Array]:
    """Evaluate Table 5 for scratch; m, m/s and N in, unweighted terms out, at most 1 and e^-2."""
    v, f = speed / BEST_SPEED, force / BEST_FORCE
    return {
        "reach_target": reach_term(distance),
        "scratch": (distance < REACH) * (v * jnp.exp(-v)) * (f * jnp.exp(-f)),
    }
