"""What the gentle tasks share: touch of all of the robot, what roughness costs, a preference.

Shapes: N simulations. Forces in N, lengths in m, speeds in m/s.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.preferences import PREFERENCES, VALUES, WISHES
from assistax_envs.tasks.base import HUMAN_JOINTS, Pose, Readings, Sensors, rotate

STEP = 0.02  # s, one control step
SOFT = 10.0  # N, a gentle touch, after Assistive Gym's limit
# N, of one contact. ISO/TS 15066 (Table A.2) has 65 N for the face, 140 to 160 N for hand and arm,
# as what healthy adults bear in a quasi-static contact before it hurts. The people here are frail:
# the least of them holds everywhere.
HARD = 65.0
FELT = 0.3  # N, from where on a touch counts as one
LIGHTEST = 0.1  # N, below which the hook has let go


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Liking:
    """The preference of each simulation's human, [N] each."""

    force: jax.Array  # N
    speed: jax.Array  # m/s
    distance: jax.Array  # m
    place: jax.Array  # m

    def observed(self, task: str) -> jax.Array:
        """Return what the human of a task knows of it, [N, W]: 0 for the middle, logarithmic."""
        shares = (getattr(self, wish) / VALUES[wish][1] for wish in WISHES[task])
        return jnp.stack([jnp.log(share) for share in shares], axis=-1)


def liking(preference: jax.Array, key: jax.Array) -> Liking:
    """Return the preference of one simulation.

    Row `preference` - 1 of `PREFERENCES`, or one drawn where it is 0.
    """
    table = jnp.asarray([dataclasses.astuple(one) for one in PREFERENCES.values()], jnp.float32)
    drawn = jax.random.randint(key, (), 0, len(PREFERENCES))
    return Liking(*table[jnp.where(preference > 0, preference - 1, drawn)])


def wishes(params: Any, key: jax.Array) -> Liking:
    """Return what the human of one simulation likes: its own wishes, or those of a preference."""
    return liking(params.preference, key) if params.likes is None else params.likes


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TouchReadings(Readings):
    """Readings of a scene in which every touch is felt.

    `tool_force` is of all of the robot, in the world's frame.
    """

    force: jax.Array  # [N] N, the magnitudes of its contacts, summed
    peak: jax.Array  # [N] N, the largest contact
    on_arm: jax.Array  # [N] N, of the tool on right arm and hand
    bent: jax.Array  # [N] rad, how far the trunk is bent from rest


class TouchSensors(Sensors):
    """Reads a gentle scene: a sensor of force and frame for every pair of robot and human."""

    def __init__(self, model: mujoco.MjModel, pose: Pose) -> None:
        super().__init__(model)
        named = [model.sensor(index) for index in range(model.nsensor)]
        touches = [sensor for sensor in named if sensor.name.startswith(("force-", "touch-"))]
        self._touch = np.stack([np.arange(s.adr[0], s.adr[0] + s.dim[0]) for s in touches])
        self._on_arm = np.array([sensor.name.startswith("force-") for sensor in touches])
        trunk = [i for i, name in enumerate(HUMAN_JOINTS) if "abdomen" in name]
        rest = pose.angle[[model.joint(HUMAN_JOINTS[i]).qposadr[0] for i in trunk]]
        self._trunk, self._rest = np.array(trunk), rest

    def read(self, values: jax.Array) -> TouchReadings:
        """Split `values` [N, nsensordata] into readings; quaternions have w >= 0."""
        base = super().read(values)
        force, normal, tangent = jnp.split(values[:, self._touch], 3, axis=-1)  # [N, pairs, 3] each
        size = jnp.linalg.norm(force, axis=-1)
        bent = jnp.abs(base.human_position[:, self._trunk] - self._rest[None]).max(axis=1)
        fields = {field.name: getattr(base, field.name) for field in dataclasses.fields(Readings)}
        fields["tool_orientation"] = _canonical(base.tool_orientation)
        fields["arm_orientation"] = _canonical(base.arm_orientation)
        fields["tool_force"] = world_force(force, normal, tangent).sum(axis=1)
        return TouchReadings(
            **fields,
            force=size.sum(axis=1),
            peak=size.max(axis=1),
            on_arm=(size * self._on_arm[None]).sum(axis=1),
            bent=bent,
        )


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


def bump(x: jax.Array, best: jax.Array) -> jax.Array:
    """Return (x / best) exp(1 - x / best): 1 at the best, 0 at zero and far above.

    The paper's form for v* and f*.
    """
    return x / best * jnp.exp(1.0 - x / best)


COSTS = {
    "force": 0.5,
    "stray": 0.2,
    "haste": 0.1,
    "trunk": 0.2,
    "violation": 1.0,
}  # weights of `costs`


def costs(readings: TouchReadings, soft: float = SOFT) -> dict[str, jax.Array]:
    """Return what roughness costs, [N] each, unweighted, in [-1, 0].

    After Assistive Gym's preference terms.

    Args:
        readings: of this step.
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
        "violation": -(readings.peak > HARD).astype(jnp.float32),
    }


def with_preference(
    obs: dict[str, jax.Array], seen: jax.Array, told: tuple[str, ...]
) -> dict[str, jax.Array]:
    """Add what only the human knows, `seen` [N, W], to what central critics and the `told` see.

    A human that is not told, for measurements, sees zeros in its place.
    """
    added = {"global": seen, "human": seen if "human" in told else jnp.zeros_like(seen)}
    added |= {"robot": seen} if "robot" in told else {}
    return {
        name: jnp.concatenate([value, added[name]], axis=-1) if name in added else value
        for name, value in obs.items()
    }


def _canonical(quaternion: jax.Array) -> jax.Array:
    """Return the same rotations [..., 4] with w >= 0."""
    return quaternion * jnp.where(quaternion[..., :1] < 0.0, -1.0, 1.0)
