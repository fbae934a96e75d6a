"""Bed bath: the robot wipes 52 points of the human's right arm in turn (paper, 3.1 and A)."""

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
    | {  # joint -> (angle, lowest offset, highest offset), rad: the arm lies beside the body
        "human_abdomen_y": (0.04, 0.0, 0.0),
        "human_abdomen_z": (-0.012, 0.0, 0.0),
        "human_right_shoulder1": (0.0, -0.03, 0.03),
        "human_right_shoulder2": (-0.84, 0.0, 0.05),
        "human_right_elbow": (-1.571, 0.0, 0.05),
        "human_left_shoulder2": (0.84, 0.0, 0.0),
        "human_left_elbow": (-1.571, 0.0, 0.0),
    }
)
POINTS = 52  # half of them on either segment
GOLDEN_ANGLE = 2.39996  # rad; neighbours on the helix lie on different sides of the arm


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BedBathState:
    """Progress of the bath."""

    wiped: (
        jax.Array
    )  # int32 points wiped; the next one is the target, after the last the last stays


class BedBath:
    """Reach the next point and touch there.

    `exp(-d^2/sigma) + [d < 0.1] [f > 0]`, the second once for each point.
    """

    name = scene = "bed_bath"
    stops: ClassVar = False
    target_colours: ClassVar = {
        "next": (0.95, 0.05, 0.55, 1.0),
        "to wipe": (0.05, 0.20, 0.75, 1.0),
    }  # RGBA

    def __init__(self, model: mujoco.MjModel, weights: dict[str, float] | None = None) -> None:
        self.weights = {"reach_target": 1.0, "wipe": 1.0} | (weights or {})
        self.pose, self.sensors = Pose(model, START), Sensors(model)
        self._segment, self._offset = arm_points(model)

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, BedBathState]:
        """Draw the start pose [nq]; the first target is at the shoulder, the last at the wrist."""
        del params
        return self.pose.draw(key), BedBathState(jnp.zeros((), jnp.int32))

    def targets(self, task_state: BedBathState, readings: Readings) -> dict[str, jax.Array]:
        """See `Task.targets`: the next point, and those after it."""
        n = task_state.wiped.shape[0]
        every = [self._point(jnp.full(n, i, jnp.int32), readings) for i in range(POINTS)]
        left = jnp.arange(POINTS)[None, :, None] > task_state.wiped[:, None, None]
        return {
            "next": self._point(task_state.wiped, readings)[:, None],
            "to wipe": jnp.where(left, jnp.stack(every, axis=1), jnp.nan),
        }

    def transition(
        self, task_state: BedBathState, readings: Readings
    ) -> tuple[BedBathState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds once every point is wiped."""
        _, distance = to_target(self._point(task_state.wiped, readings), readings)
        force = jnp.linalg.norm(readings.tool_force, axis=-1)
        wipe = (distance < REACH) & (force > 0.0) & (task_state.wiped < POINTS)
        wiped = task_state.wiped + wipe
        terms = {"reach_target": reach_term(distance), "wipe": wipe.astype(jnp.float32)}
        towards, next_distance = to_target(self._point(wiped, readings), readings)
        measures = Measures(force, distance, wiped >= POINTS)
        return (
            BedBathState(wiped),
            observations(readings, towards, next_distance[:, None]),
            terms,
            measures,
        )

    def _point(self, wiped: jax.Array, readings: Readings) -> jax.Array:
        """Return the target [N, 3] after `wiped` [N] points."""
        index = jnp.minimum(wiped, POINTS - 1)
        return segment_points(
            readings, jnp.asarray(self._segment)[index], jnp.asarray(self._offset)[index]
        )


def arm_points(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the points to wipe, on a helix from shoulder to wrist.

    Segment [52], and offset [52, 3] in its frame, m.
    """
    sites = [model.site(f"human_{segment}") for segment in ARM_SEGMENTS]
    return _helix([(site.size[0], site.size[1]) for site in sites])


def _helix(sizes: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return segment [52] and offset [52, 3] of points on the skin, from shoulder to wrist.

    Args:
        sizes: radius and half length of each segment, m.
    """
    each = POINTS // len(sizes)
    along = np.linspace(-1.0, 1.0, each)
    angle = GOLDEN_ANGLE * np.arange(each)
    offsets = [
        np.stack([radius * np.cos(angle), radius * np.sin(angle), half * along], axis=-1)
        for radius, half in sizes
    ]
    return np.repeat(np.arange(len(sizes), dtype=np.int32), each), np.concatenate(offsets).astype(
        np.float32
    )
