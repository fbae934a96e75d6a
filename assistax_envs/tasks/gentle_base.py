"""Parts that the gentle tasks share: touches of the robot, costs of roughness, preferences.

Shapes: N simulations. Forces in N, lengths in m, speeds in m/s.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.physics.base import felt_sensors
from assistax_envs.preferences import PREFERENCES, PREFERRED, middles
from assistax_envs.tasks.base import Pose, Readings, Sensors, human_joints, rotate
from assistax_envs.tasks.gentle_rules import IMPACT_LIMITS, LIMITS

STEP = 0.02  # s, one control step
SOFT = 10.0  # N, a gentle touch, after Assistive Gym's limit
FELT = 0.3  # N, from where on a touch counts as one
LIGHTEST = 0.1  # N, below which the hook has let go
LIGHT = 0.5  # share of what a person prefers, below which it leans in


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Preferences:
    """Values that each simulation's human prefers, [N] each."""

    force: jax.Array  # N
    speed: jax.Array  # m/s
    distance: jax.Array  # m
    place: jax.Array  # m
    wait: jax.Array  # m
    depth: jax.Array  # m
    press: jax.Array  # N
    tolerance: jax.Array  # force that hurts, in units of the task: see `care.after`

    def of(self, task: str) -> jax.Array:
        """Return the values [N, W] that a task's humans have a wish about."""
        return jnp.stack([getattr(self, name) for name in PREFERRED[task]], axis=-1)

    def observed(self, task: str) -> jax.Array:
        """Return the logarithm [N, W] of each value over its middle, of a task's quantities."""
        return jnp.log(self.of(task) / jnp.array([middles(task)]))


def draw_preferences(code: jax.Array, key: jax.Array) -> Preferences:
    """Return the preferences of one simulation.

    Row `code` - 1 of `PREFERENCES`, or one drawn if it is 0.
    """
    table = jnp.asarray([dataclasses.astuple(one) for one in PREFERENCES.values()], jnp.float32)
    drawn = jax.random.randint(key, (), 0, len(PREFERENCES))
    return Preferences(*table[jnp.where(code > 0, code - 1, drawn)])


def episode_preferences(params: Any, key: jax.Array) -> Preferences:
    """Return the preferences of one simulation's human: its own, or those of its code."""
    return (
        draw_preferences(params.preference_code, key)
        if params.preference is None
        else params.preference
    )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TouchReadings(Readings):
    """Readings of a scene in which every touch is felt.

    `tool_force` is of all of the robot, in the world's frame.
    """

    force: jax.Array  # [N] N, the magnitudes of its contacts, summed
    peak: jax.Array  # [N] N, the largest contact
    hurt: jax.Array  # [N] bool: some contact is above the quasi-static limit of its part
    struck: jax.Array  # [N] bool: some contact is above the limit of impacts
    together: jax.Array  # [N] N, the largest sum of contacts at once in any physics step
    face: jax.Array  # [N] m, from the tool to the head's surface
    on_arm: jax.Array  # [N] N, of the tool on right arm and hand
    bent: jax.Array  # [N] rad, how far the trunk is bent from rest


class TouchSensors(Sensors):
    """Reads a gentle scene: a sensor of force and frame for every pair of robot and human."""

    def __init__(self, model: mujoco.MjModel, pose: Pose) -> None:
        super().__init__(model)
        touches = [model.sensor(index) for index in felt_sensors(model)]
        self._touch = np.stack([np.arange(s.adr[0], s.adr[0] + s.dim[0]) for s in touches])
        parts = [model.geom(int(sensor.refid[0])).name for sensor in touches]
        self._limits = np.array([LIMITS[part] for part in parts], np.float32)
        self._impacts = np.array([IMPACT_LIMITS[part] for part in parts], np.float32)
        self._peaks = model.nsensordata
        self._on_arm = np.array([sensor.name.startswith("force-") for sensor in touches])
        joints = human_joints(model)
        trunk = [i for i, name in enumerate(joints) if "abdomen" in name]
        rest = pose.angle[[model.joint(joints[i]).qposadr[0] for i in trunk]]
        self._trunk, self._rest = np.array(trunk), rest
        self._head = _Head(model)

    def read(self, values: jax.Array) -> TouchReadings:
        """Split `values` [N, nsensordata] into readings; quaternions have w >= 0."""
        base = super().read(values)
        force, normal, tangent = jnp.split(values[:, self._touch], 3, axis=-1)  # [N, pairs, 3] each
        size = jnp.linalg.norm(force, axis=-1)
        # Of each pair, and of their sum; what pictures are drawn from has the sensors alone.
        peaks = values[:, self._peaks :]
        if values.shape[1] == self._peaks:
            peaks = jnp.concatenate([size, size.sum(axis=1, keepdims=True)], axis=1)
        worst = peaks[:, :-1]
        bent = jnp.abs(base.human_position[:, self._trunk] - self._rest[None]).max(axis=1)
        fields = {field.name: getattr(base, field.name) for field in dataclasses.fields(Readings)}
        fields["tool_orientation"] = _canonical(base.tool_orientation)
        fields["arm_orientation"] = _canonical(base.arm_orientation)
        fields["tool_force"] = world_force(force, normal, tangent).sum(axis=1)
        return TouchReadings(
            **fields,
            force=size.sum(axis=1),
            peak=worst.max(axis=1),
            hurt=(worst > self._limits[None]).any(axis=1),
            struck=(worst > self._impacts[None]).any(axis=1),
            together=peaks[:, -1],
            face=self._head.distance(base.human_position[:, self._trunk], base.tool_position),
            on_arm=(size * self._on_arm[None]).sum(axis=1),
            bent=bent,
        )


class _Head:
    """Position of the head, which the trunk's joints carry."""

    def __init__(self, model: mujoco.MjModel) -> None:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)  # all joints at zero
        joints = [model.joint(name).id for name in human_joints(model) if "abdomen" in name]
        geom = model.geom("human_head")
        self._anchor, self._axis = data.xanchor[joints], data.xaxis[joints]
        self._centre, self._radius = data.geom_xpos[geom.id].copy(), float(geom.size[0])

    def distance(self, angles: jax.Array, point: jax.Array) -> jax.Array:
        """Return the distance [N] of points [N, 3] from its surface, m; `angles` [N, 3] in rad."""
        centre = jnp.broadcast_to(jnp.asarray(self._centre, jnp.float32)[None], point.shape)
        for joint in reversed(range(angles.shape[1])):  # each joint moves what those after it moved
            half = 0.5 * angles[:, joint : joint + 1]
            axis = jnp.asarray(self._axis[joint], jnp.float32)[None]
            turn = jnp.concatenate([jnp.cos(half), axis * jnp.sin(half)], axis=-1)
            anchor = jnp.asarray(self._anchor[joint], jnp.float32)[None]
            centre = anchor + rotate(turn, centre - anchor)
        return jnp.linalg.norm(point - centre, axis=-1) - self._radius


def world_force(force: jax.Array, normal: jax.Array, tangent: jax.Array) -> jax.Array:
    """Turn forces [..., 3] of contact frames into the world's.

    Along the normal, the tangent and their product.
    """
    other = jnp.cross(normal, tangent)
    return force[..., :1] * normal + force[..., 1:2] * tangent + force[..., 2:] * other


def in_segment(readings: Readings, segment: jax.Array, point: jax.Array) -> jax.Array:
    """Return world points [N, 3] in the frame of arm segments [N]."""
    row = jnp.arange(point.shape[0])
    conjugate = readings.arm_orientation[row, segment] * jnp.array([1.0, -1.0, -1.0, -1.0])[None]
    return rotate(conjugate, point - readings.arm_position[row, segment])


def along_skin(step: jax.Array, at: jax.Array) -> jax.Array:
    """Return the length [...] of steps [..., 3] over the skin, at points of a segment's frame.

    The part across the skin is left out.
    """
    radial = at.at[..., 2].set(0.0)
    radial = radial / jnp.maximum(jnp.linalg.norm(radial, axis=-1, keepdims=True), 1e-6)
    across = (step * radial).sum(-1, keepdims=True) * radial
    return jnp.linalg.norm(step - across, axis=-1)


ROUGHNESS = {
    "force": 0.5,
    "stray": 0.2,
    "haste": 0.1,
    "trunk": 0.2,
    "violation": 1.0,
}  # weights of `roughness`


def roughness(
    readings: TouchReadings, violated: jax.Array, soft: float = SOFT
) -> dict[str, jax.Array]:
    """Return the costs of roughness, [N] each, unweighted, in [-1, 0].

    After Assistive Gym's preference terms.

    Args:
        readings: of this step.
        violated: [N] bool, whether a violation ended the episode.
        soft: N, the sum of all touches that costs nothing yet.
    """

    def share(x: jax.Array, scale: float) -> jax.Array:
        return -jnp.minimum(1.0, jnp.maximum(x, 0.0) / scale)

    return {
        "force": share(readings.force - soft, 40.0),
        "stray": share(
            readings.force - readings.on_arm, 20.0
        ),  # of anything but the tool on the arm
        "haste": share(jnp.linalg.norm(readings.tool_velocity, axis=-1) - 0.3, 0.5),
        "trunk": share(readings.bent - 0.05, 0.1),
        "violation": -violated.astype(jnp.float32),
    }


def with_preference(
    obs: dict[str, jax.Array], felt: jax.Array, seen: jax.Array, told: tuple[str, ...]
) -> dict[str, jax.Array]:
    """Add `seen` [N, W] to the observations of central critics and of the `told` roles.

    A human that is not told, which measurements need, observes zeros instead. Critics and humans
    also observe what is `felt` [N, F].
    """
    shown = seen if "human" in told else jnp.zeros_like(seen)
    added = {
        "global": jnp.concatenate([felt, seen], axis=-1),
        "human": jnp.concatenate([felt, shown], axis=-1),
    }
    added |= {"robot": seen} if "robot" in told else {}
    return {
        name: jnp.concatenate([value, added[name]], axis=-1) if name in added else value
        for name, value in obs.items()
    }


def _canonical(quaternion: jax.Array) -> jax.Array:
    """Return the same rotations [..., 4] with w >= 0."""
    return quaternion * jnp.where(quaternion[..., :1] < 0.0, -1.0, 1.0)
