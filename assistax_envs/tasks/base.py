"""Parts that all tasks share: sensor readings, observations by role, and a task's protocol."""

import dataclasses
import math
from typing import Any, ClassVar, Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

ROBOT_JOINTS = tuple(f"robot_joint{i}" for i in range(1, 8))
HUMAN_JOINTS = (
    "human_abdomen_x",
    "human_abdomen_y",
    "human_abdomen_z",
    "human_right_shoulder1",
    "human_right_shoulder2",
    "human_right_elbow",
    "human_left_shoulder1",
    "human_left_shoulder2",
    "human_left_elbow",
)
HUMAN_ACTUATORS = ("human_right_shoulder1", "human_right_shoulder2", "human_right_elbow")
ARM_SEGMENTS = ("right_upper_arm", "right_lower_arm")
LOWER_ARM = 1  # row of ARM_SEGMENTS
# Joint -> (angle, lowest offset, highest offset), rad: the tool points down in front of the base.
ROBOT_READY = {
    "robot_joint1": (0.0, -0.1, 0.1),
    "robot_joint2": (-0.785, -0.1, 0.1),
    "robot_joint3": (0.0, -0.1, 0.1),
    "robot_joint4": (-2.356, -0.1, 0.1),
    "robot_joint5": (0.0, -0.1, 0.1),
    "robot_joint6": (1.571, -0.1, 0.1),
    "robot_joint7": (0.785, -0.1, 0.1),
}
SIGMA = 0.1  # Table 5's sigma: m^2 in the reaching term, m in the waist term
REACH = 0.1  # m, how near the tool must be to its target to scratch or wipe
TOUCHABLE = (*ARM_SEGMENTS, "right_hand")  # what the tool's contact force counts


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Readings:
    """Sensor values of a batch by name; SI units, world frame, axis N first."""

    robot_position: jax.Array  # [N, 7] joint angles, rad
    robot_velocity: jax.Array  # [N, 7] rad/s
    human_position: jax.Array  # [N, J] joint angles, rad: 9, but at the mouth 7
    human_velocity: jax.Array  # [N, J] rad/s
    tool_position: jax.Array  # [N, 3] end-effector, m
    tool_orientation: jax.Array  # [N, 4] quaternion (w, x, y, z)
    tool_velocity: jax.Array  # [N, 3] m/s
    tool_force: (
        jax.Array
    )  # [N, 3] force between tool and arm in MuJoCo's contact frame (normal first), N
    arm_position: jax.Array  # [N, 2, 3] centres of upper and lower arm, m
    arm_orientation: jax.Array  # [N, 2, 4] their quaternions, z along the segment


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Measures:
    """Measures that evaluation records beside the reward."""

    force: jax.Array  # [N] magnitude of the tool's force on the arm, N
    distance: jax.Array  # [N] from tool to target, m
    success: jax.Array  # [N] bool: the task's goal holds at this step
    # Of the gentle tasks, whose sensors feel every touch:
    contact: jax.Array | None = None  # [N] N, the largest single contact
    violated: jax.Array | None = None  # [N] bool: some contact so far was a violation
    violation: jax.Array | None = None  # [N] int32, its kind: see `care.Care`
    together: jax.Array | None = None  # [N] N, the largest sum of contacts at once
    # [N] bool: touched with a joint of the right arm at an end of its range; by the environment
    at_end: jax.Array | None = None
    speed: jax.Array | None = None  # [N] m/s, of the tool
    face: jax.Array | None = None  # [N] m, from the tool to the head
    # Of the W wishes of the task, in the order of its preferences:
    done: jax.Array | None = None  # [N, W] what is done of each, smoothed
    liked: jax.Array | None = None  # [N, W] what the human likes
    judged: jax.Array | None = None  # [N, W] bool: whether it is judged at this step
    felt: jax.Array | None = None  # [N] bool: the human felt something
    discomfort: jax.Array | None = None  # [N] 0 to 2


def human_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the human's joints in a scene: `HUMAN_JOINTS`, but for the tasks at the mouth."""
    names = (model.joint(i).name for i in range(model.njnt))
    return tuple(name for name in names if name.startswith("human_"))


def human_actuators(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the actuators of the human's seat: `HUMAN_ACTUATORS`, or others at the mouth."""
    names = (model.actuator(i).name for i in range(model.nu))
    return tuple(name for name in names if name.startswith("human_"))


def _read_from(model: mujoco.MjModel) -> dict[str, tuple[list[str], tuple[int, ...]]]:
    """Return the sensors of each field of `Readings`, and the shape of its row."""
    human = human_joints(model)
    names = (model.sensor(i).name for i in range(model.nsensor))
    forces = [name for name in names if name.startswith("force-")]
    return {
        "robot_position": ([f"{joint}_position" for joint in ROBOT_JOINTS], (7,)),
        "robot_velocity": ([f"{joint}_velocity" for joint in ROBOT_JOINTS], (7,)),
        "human_position": ([f"{joint}_position" for joint in human], (len(human),)),
        "human_velocity": ([f"{joint}_velocity" for joint in human], (len(human),)),
        "tool_position": (["robot_end_effector_position"], (3,)),
        "tool_orientation": (["robot_end_effector_orientation"], (4,)),
        "tool_velocity": (["robot_end_effector_velocity"], (3,)),
        "tool_force": (forces, (len(forces), 3)),
        "arm_position": ([f"human_{segment}_position" for segment in ARM_SEGMENTS], (2, 3)),
        "arm_orientation": ([f"human_{segment}_orientation" for segment in ARM_SEGMENTS], (2, 4)),
    }


class Sensors:
    """Reads a model's sensor vector by the names that every task's scene defines."""

    def __init__(self, model: mujoco.MjModel) -> None:
        def columns(names: list[str], shape: tuple[int, ...]) -> np.ndarray:
            # The first numbers of each: the gentle scenes' forces give the contact's frame as well.
            numbers = np.arange(math.prod(shape) // len(names))
            return np.concatenate([model.sensor(name).adr[0] + numbers for name in names])

        fields = _read_from(model)
        self._columns = {field: columns(*sensors) for field, sensors in fields.items()}
        self._shapes = {field: shape for field, (_, shape) in fields.items()}

    def read(self, values: jax.Array) -> Readings:
        """Split `values` [N, nsensordata] into readings."""
        fields = {
            field: values[:, columns].reshape(values.shape[0], *self._shapes[field])
            for field, columns in self._columns.items()
        }
        return Readings(**fields | {"tool_force": fields["tool_force"].sum(axis=1)})


class Task(Protocol):
    """A task: starts of episodes, observations of roles, and rewards.

    Pure JAX on sensor values, batch axis first.
    """

    name: str
    scene: str  # name of the task whose scene, seat and tool it takes; its own name if registered
    weights: dict[str, float]  # of the reward terms
    pose: "Pose"  # of the joints at the start
    sensors: "Sensors"
    target_colours: ClassVar[dict[str, tuple[float, ...]]]  # of `targets`, RGBA
    # Whether a violation ends the episode; measures then have the fields of the gentle tasks.
    stops: ClassVar[bool]

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, Any]:
        """Draw joint positions [nq] and the task state of one simulation from one key.

        `params` is its row of `EnvParams`: the gentle tasks take the human's preference from it.
        """
        ...

    def targets(self, task_state: Any, readings: Readings) -> dict[str, jax.Array]:
        """Return the positions of targets by name, for pictures: [N, K, 3] in m; NaN hides one."""
        ...

    def transition(
        self, task_state: Any, readings: Readings
    ) -> tuple[Any, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """Return the next task state, observations, unweighted reward terms [N] and measures."""
        ...


class Pose:
    """Start of the joints: an angle for each named joint, with uniform noise about it."""

    def __init__(self, model: mujoco.MjModel, start: dict[str, tuple[float, float, float]]) -> None:
        """Take `start`: joint -> (angle, lowest offset, highest offset), rad.

        Other joints start at zero.
        """
        addresses = np.array([model.joint(name).qposadr[0] for name in start])
        table = np.array(list(start.values()), np.float32)
        self.angle, self._low, self._high = (np.zeros(model.nq, np.float32) for _ in range(3))
        for row, values in zip((self.angle, self._low, self._high), table.T, strict=True):
            row[addresses] = values

    def draw(self, key: jax.Array) -> jax.Array:
        """Draw joint positions [nq]."""
        noise = jax.random.uniform(key, self.angle.shape, minval=self._low, maxval=self._high)
        return jnp.asarray(self.angle) + noise


def segment_points(readings: Readings, segment: jax.Array, offset: jax.Array) -> jax.Array:
    """Return world positions [N, 3] of points fixed to arm segments.

    Args:
        readings: readings with the segments' places.
        segment: [N] index into `ARM_SEGMENTS`.
        offset: [N, 3] of the point in the segment's frame, m.
    """
    row = jnp.arange(segment.shape[0])
    return readings.arm_position[row, segment] + rotate(
        readings.arm_orientation[row, segment], offset
    )


def to_target(target: jax.Array, readings: Readings) -> tuple[jax.Array, jax.Array]:
    """Return the vector [N, 3] from the tool to `target` [N, 3] and its length [N], m."""
    towards = target - readings.tool_position
    return towards, jnp.linalg.norm(towards, axis=-1)


def reach_term(distance: jax.Array) -> jax.Array:
    """Return Table 5's `exp(-d^2 / sigma)`; at most 1."""
    return jnp.exp(-jnp.square(distance) / SIGMA)


def rotation_matrix(quaternion: jax.Array) -> jax.Array:
    """Return the matrix [..., 3, 3] of a unit `quaternion` [..., 4] (w, x, y, z)."""
    axes = jnp.broadcast_to(jnp.eye(3, dtype=quaternion.dtype), (*quaternion.shape[:-1], 3, 3))
    columns = rotate(
        jnp.broadcast_to(quaternion[..., None, :], (*quaternion.shape[:-1], 3, 4)), axes
    )
    return jnp.swapaxes(columns, -1, -2)


def rotate(quaternion: jax.Array, vector: jax.Array) -> jax.Array:
    """Rotate `vector` [..., 3] by the unit `quaternion` [..., 4] (w, x, y, z)."""
    w, u = quaternion[..., :1], quaternion[..., 1:]
    t = 2.0 * jnp.cross(u, vector)
    return vector + w * t + jnp.cross(u, t)


def observations(
    readings: Readings, *goal: jax.Array, body: tuple[jax.Array, ...] | None = None
) -> dict[str, jax.Array]:
    """Lay out Table 4: own proprioception first, then tool, force, arm and `goal`.

    "global" is the whole table. Tasks at the mouth give its place and direction as `body`, in
    place of the arm's.
    """
    tool = (readings.tool_position, readings.tool_orientation, readings.tool_force)
    robot = (readings.robot_position, readings.robot_velocity)
    human = (readings.human_position, readings.human_velocity)
    lower_and_upper = (readings.arm_position[:, 1], readings.arm_position[:, 0])
    arm = lower_and_upper if body is None else body
    return {
        "robot": jnp.concatenate([*robot, *tool, *arm, *goal], axis=-1),
        "human": jnp.concatenate([*human, *tool, *arm, *goal], axis=-1),
        "global": jnp.concatenate([*robot, *tool, *human, *arm, *goal], axis=-1),
    }


def unit(vector: jax.Array) -> jax.Array:
    """Return vectors [N, 3] of length 1 in the same directions; shorter ones than 1e-6 m shrink."""
    return vector / jnp.maximum(jnp.linalg.norm(vector, axis=-1, keepdims=True), 1e-6)


def check_terms(task: Task, terms: dict[str, Any]) -> None:
    """Check that a task gives a reward term for each weight.

    Raises:
        ValueError: A weight has no term.
    """
    if set(task.weights) != set(terms):
        unknown = sorted(set(task.weights) - set(terms))
        raise ValueError(
            f"reward weights for unknown terms {unknown}; {task.name} has {sorted(terms)}"
        )
