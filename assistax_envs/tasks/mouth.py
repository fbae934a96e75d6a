"""Readings of a scene of care at the mouth: its place, its opening, forces on lips or teeth."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.models.care_scenes import LIPS, MOUTH, SKULL, SKULL_SIZE
from assistax_envs.physics.base import felt_sensors
from assistax_envs.tasks.base import Pose, human_joints, rotate
from assistax_envs.tasks.gentle_base import TouchReadings, TouchSensors

WAITING, ENTERING, TAKING, LEAVING, FULL = range(5)  # stages of a bite, and after the meal
FARTHEST, BESIDE = 0.25, 0.05  # m: a mouth opens for a spoon that is no farther, and not beside it
SLOWLY = 0.1  # m/s, likewise
OPENED = 0.4  # rad, what a mouth opens to for a spoon or a brush
UNIT = 2.0  # N, of a spoon on the lips: a tolerance of 1
TURNED = 0.5  # rad of the neck's yaw, what a head turns to for a brush


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MouthReadings(TouchReadings):
    """Readings of the mouth; its axis points out of it."""

    mouth_position: jax.Array  # [N, 3] m, between the lips
    mouth_orientation: jax.Array  # [N, 4] of the head, x forward, z up
    forward: jax.Array  # [N, 3] the mouth's axis
    bowl: jax.Array  # [N, 3] m, the tool in the mouth's frame: how far out, to the left, above
    up: jax.Array  # [N, 3] the way out of the bowl, in the world
    level: jax.Array  # [N] cosine of the bowl's tilt
    jaw: jax.Array  # [N] rad
    felt: jax.Array  # [N, K] N, of the tool on each lip, or on each row of teeth


@dataclasses.dataclass(frozen=True)
class Perceived:
    """Perception of a person at the mouth, after its delay, and its own state."""

    tool: jax.Array  # [N, 3] m, in the mouth's frame
    force: jax.Array  # [N] N, of all touches
    moving: jax.Array  # [N] m/s, smoothed speed of the tool in the mouth's frame
    flag: jax.Array  # [N] part "flag" of the observation
    place: jax.Array  # [N] int32, index of the one-hot part "progress", without delay
    before: jax.Array  # [N] int32, the same a step ago
    willing: jax.Array  # [N] s for which the person has been willing
    aim: jax.Array  # [N, 5] rad, the posture that it moves to
    eager: jax.Array  # [N] 0.5 to 1, by the person's initiative
    numbers: dict[str, jax.Array]  # [N] each, the person's numbers by name


@dataclasses.dataclass(frozen=True)
class Comfort:
    """Forces and shares by which a person at the mouth judges what it perceives, [N] each."""

    unit: jax.Array  # N: a tolerance of 1 is this force
    preferred: jax.Array  # N: below a share of it pressure is missed
    speed: jax.Array  # speed of the tool, as a share of the preferred one
    near: jax.Array  # distance of the tool, as a share of the preferred one
    way: jax.Array  # 1, or -1 for a tool that presses from within: it is relieved by coming nearer


class MouthSensors(TouchSensors):
    """Reads such a scene; `felt` are the parts that the tool is meant to press."""

    def __init__(self, model: mujoco.MjModel, pose: Pose, felt: tuple[str, ...] = LIPS) -> None:
        super().__init__(model, pose)
        first = {
            field: int(model.sensor(f"human_mouth_{field}").adr[0])
            for field in ("position", "orientation")
        }
        self._position = first["position"] + np.arange(3)
        self._turn = first["orientation"] + np.arange(4)
        names = [model.sensor(index).name for index in felt_sensors(model)]
        touch = np.stack([self._touch[names.index(f"force-{part}")] for part in felt])
        self._felt = touch[:, :3]  # forces come before frames
        self._jaw = human_joints(model).index("human_jaw")

    def read(self, values: jax.Array) -> MouthReadings:
        """Split `values` [N, nsensordata] into readings; quaternions have w >= 0."""
        base = super().read(values)
        mouth, turn = values[:, self._position], values[:, self._turn]

        def axis(quaternion: jax.Array, which: int) -> jax.Array:
            return rotate(quaternion, jnp.broadcast_to(jnp.eye(3)[which], mouth.shape))

        up = axis(base.tool_orientation, 0)
        conjugate = turn * jnp.array([1.0, -1.0, -1.0, -1.0])[None]
        skull = jnp.broadcast_to(jnp.array(np.subtract(SKULL, MOUTH), jnp.float32), mouth.shape)
        centre = mouth + rotate(turn, skull)
        fields = {f.name: getattr(base, f.name) for f in dataclasses.fields(TouchReadings)}
        fields["face"] = jnp.linalg.norm(base.tool_position - centre, axis=-1) - SKULL_SIZE
        return MouthReadings(
            **fields,
            mouth_position=mouth,
            mouth_orientation=turn,
            forward=axis(turn, 0),
            bowl=rotate(conjugate, base.tool_position - mouth),
            up=up,
            level=up[:, 2],
            jaw=base.human_position[:, self._jaw],
            felt=jnp.linalg.norm(values[:, self._felt], axis=-1),
        )
