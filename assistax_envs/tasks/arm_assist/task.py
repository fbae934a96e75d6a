"""Arm assist: the robot lifts the human's hanging arm back onto the bed (paper, 3.1 and A)."""

import dataclasses
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks.base import (
    LOWER_ARM,
    ROBOT_JOINTS,
    SIGMA,
    Measures,
    Pose,
    Readings,
    Sensors,
    observations,
    reach_term,
    rotation_matrix,
    to_target,
)

# rad: the hook stands upright 12 cm below the forearm and 16 cm towards the head from it, clear of
# the arm. From above, where the other tasks begin, the shortest way to the section ends on top of
# the arm, and most robots stay there.
HOOK_LOW = (1.345, 0.545, -0.31, -2.388, 0.002, 3.015, 1.787)
START = {joint: (angle, -0.1, 0.1) for joint, angle in zip(ROBOT_JOINTS, HOOK_LOW, strict=True)} | {
    # joint -> (angle, lowest offset, highest offset), rad: the arm hangs over the bed's edge
    "human_abdomen_y": (0.036, 0.0, 0.0),
    "human_abdomen_z": (-0.014, 0.0, 0.0),
    "human_right_shoulder1": (-0.92, -0.02, 0.02),
    "human_right_shoulder2": (-0.98, 0.0, 0.03),
    "human_right_elbow": (-1.571, 0.0, 0.05),
    "human_left_shoulder2": (0.84, 0.0, 0.0),
    "human_left_elbow": (-1.571, 0.0, 0.0),
}
WAIST = (
    -0.12,
    -0.27,
    0.67,
)  # m, world: where the middle of the forearm rests on the bed beside the waist
ARRIVED = 0.1  # m, how near to it counts as solved
LARGEST_NORM = (
    2.0 * 3.0**0.5
)  # of the difference of two rotation matrices, by the triangle inequality


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ArmAssistState:
    """The constant target: a row keeps the batch axis."""

    waist: jax.Array  # [3] waist target, m


class ArmAssist:
    """Hook the forearm and lift it: `exp(-d^2/sigma) + 10 (1 - tanh(d_waist/sigma)) + 0.1 norm(R)`.

    R is the difference of the hook's rotation matrix and that of the target on the forearm. As
    printed, the last term pays for misalignment; `rotation="aligned"` pays `2 sqrt(3) - norm(R)`
    instead, under the same bound.
    """

    name = scene = "arm_assist"
    stops: ClassVar = False
    target_colours: ClassVar = {
        "section": (0.95, 0.05, 0.55, 1.0),
        "waist": (0.05, 0.20, 0.75, 1.0),
    }  # RGBA

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        rotation: Literal["printed", "aligned"] = "printed",
    ) -> None:
        if rotation not in ("printed", "aligned"):
            raise ValueError(f"rotation is {rotation!r}; allowed are printed, aligned")
        self.weights = {"reach_target": 1.0, "reach_waist": 10.0, "rotation": 0.1} | (weights or {})
        self.pose, self.sensors = Pose(model, START), Sensors(model)
        self._rotation = rotation
        self._hook = _hook_in_forearm(model, self.pose)

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, ArmAssistState]:
        """Draw the start pose [nq]; the targets are the same in every episode."""
        del params
        return self.pose.draw(key), ArmAssistState(jnp.asarray(WAIST, jnp.float32))

    def targets(self, task_state: ArmAssistState, readings: Readings) -> dict[str, jax.Array]:
        """See `Task.targets`: the section of the forearm, and where it should go."""
        return {
            "section": readings.arm_position[:, LOWER_ARM][:, None],
            "waist": task_state.waist[:, None],
        }

    def transition(
        self, task_state: ArmAssistState, readings: Readings
    ) -> tuple[ArmAssistState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds while the forearm is at the waist target."""
        section = readings.arm_position[:, LOWER_ARM]
        towards, distance = to_target(section, readings)
        lift = task_state.waist - section
        left = jnp.linalg.norm(lift, axis=-1)
        forearm = rotation_matrix(readings.arm_orientation[:, LOWER_ARM])
        turn = rotation_matrix(readings.tool_orientation) - forearm @ jnp.asarray(self._hook)[None]
        turn = turn.reshape(-1, 9)
        terms = arm_assist_terms(distance, left, jnp.linalg.norm(turn, axis=-1), self._rotation)
        obs = observations(readings, towards, distance[:, None], turn, lift, left[:, None])
        return (
            task_state,
            obs,
            terms,
            Measures(jnp.linalg.norm(readings.tool_force, axis=-1), distance, left < ARRIVED),
        )


def arm_assist_terms(
    distance: jax.Array, left: jax.Array, norm: jax.Array, rotation: str
) -> dict[str, jax.Array]:
    """Evaluate Table 5 for arm assist: m, m and the norm of R in, unweighted terms out."""
    return {
        "reach_target": reach_term(distance),
        "reach_waist": 1.0 - jnp.tanh(left / SIGMA),
        "rotation": norm if rotation == "printed" else LARGEST_NORM - norm,
    }


def _hook_in_forearm(model: mujoco.MjModel, pose: Pose) -> np.ndarray:
    """Return the hook's best orientation in the forearm's frame, [3, 3].

    At the start that is: shaft (z) as upright as the forearm allows, bar (y) across the forearm,
    under it.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = pose.angle
    mujoco.mj_kinematics(model, data)
    forearm = data.site("human_right_lower_arm").xmat.reshape(3, 3)
    along = forearm[:, 2]
    down = np.array([0.0, 0.0, -1.0])
    z = down - (down @ along) * along
    z /= np.linalg.norm(z)
    return (forearm.T @ np.stack([along, np.cross(z, along), z], axis=-1)).astype(np.float32)
