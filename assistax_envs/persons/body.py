"""A person's right arm as constants of a scene: joints, weights and possible postures.

Shapes: N simulations, M postures; joints are those of `HUMAN_ACTUATORS`: two of the shoulder, the
elbow. The trunk counts as resting: it bends by hundredths of a radian.
"""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks.base import ARM_SEGMENTS, HUMAN_ACTUATORS, ROBOT_JOINTS, unit
from assistax_envs.tasks.gentle_base import STEP

JOINTS = len(HUMAN_ACTUATORS)
GRAVITY = 9.81  # m/s^2
GRID = (9, 9, 7)  # postures tried, over each joint's range
FACE = 0.25  # m from the middle of the head to that of the forearm: no arm is held nearer
PLACES = 8  # along the way to a posture, where nothing may be in between
DEEP = 0.004  # m: postures that lie deeper than this in anything are left out
_PARTS = ("human_right_upper_arm", "human_right_lower_arm", "human_right_hand")


class Arm:
    """The arm of a task's scene."""

    def __init__(self, model: mujoco.MjModel, start: np.ndarray) -> None:
        """Read it from a model; `start` [nq] is how the scene begins."""
        self.model, self._start = model, start
        joints = [model.joint(name) for name in HUMAN_ACTUATORS]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self.rest = np.array(start[self._qpos], np.float32)  # [3] rad
        self.range = np.array([model.jnt_range[joint.id] for joint in joints], np.float32)
        gear = [model.actuator(name).gear[0] for name in HUMAN_ACTUATORS]
        self.torque = np.array(gear, np.float32)  # [3] N m, the seat's most
        self._dofs = [joint.dofadr[0] for joint in joints]
        self.damping = np.array(model.dof_damping[self._dofs], np.float32)  # [3] N m s/rad
        data = self._scratch = self._posed(np.zeros(JOINTS))
        ids, self._parts = [j.id for j in joints], [model.geom(name).id for name in _PARTS]
        self._anchor = np.array(data.xanchor[ids], np.float32)  # [3, 3] m, at angles zero
        self._axis = np.array(data.xaxis[ids], np.float32)  # [3, 3]
        self._cross = np.cross(np.eye(3), self._axis[:, None]).astype(np.float32)  # [3, 3, 3]
        bodies = [
            model.body(name).id for name in ("human_right_upper_arm", "human_right_lower_arm")
        ]
        self._centre = np.array(data.xipos[bodies], np.float32)  # [2, 3] m
        self._weight = [float(model.body_mass[body] * GRAVITY) for body in bodies]  # N
        # m: the robot's shoulder, from which its arm reaches
        self.robot = np.array(data.xanchor[model.joint(ROBOT_JOINTS[1]).id], np.float32)
        sites = [model.site(f"human_{segment}") for segment in ARM_SEGMENTS]
        self._sites = np.array([site.id for site in sites])
        self._position = np.array(data.site_xpos[self._sites], np.float32)  # [2, 3] m
        self._frame = np.array(data.site_xmat[self._sites], np.float32).reshape(2, 3, 3)
        self._hand = np.array(data.geom_xpos[self._parts[-1]], np.float32)  # [3] m
        self.half_length = np.array([site.size[1] for site in sites], np.float32)  # [2] m
        self.radius = np.array([site.size[0] for site in sites], np.float32)  # [2] m

    def frames(self, angles: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return positions [N, 2, 3] and frames [N, 2, 3, 3] of both segments, z along each."""
        return self._frames(self._motions(angles))

    def hand(self, angles: jax.Array) -> jax.Array:
        """Return the place [N, 3] of the hand's middle at joint angles [N, 3]."""
        return self._motions(angles)[-1].moved(self._hand)

    def gravity(self, angles: jax.Array) -> jax.Array:
        """Return the torques [N, 3] that hold the arm's weight at joint angles [N, 3]."""
        motions = self._motions(angles)
        placed = self._placed(motions)
        upper = self._torques(placed[:2], motions[1].moved(self._centre[0]), self._weight[0])
        lower = self._torques(placed, motions[2].moved(self._centre[1]), self._weight[1])
        return -(upper + lower)

    def jacobian(self, angles: jax.Array, point: jax.Array, on_lower: jax.Array) -> jax.Array:
        """Return how joints move a point [N, 3] of the arm, [N, 3, 3]: metres by joint.

        The elbow moves what is `on_lower` [N] alone.
        """
        return self._jacobian(self._motions(angles), point, on_lower)

    def touched_by(
        self, tool: jax.Array, before: jax.Array, angles: jax.Array, velocity: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Return the unit joint direction away from a tool [N, 3], and its slip [N], m/s.

        Args:
            tool: [N, 3] m, its place.
            before: [N, 3] m, its place a step ago.
            angles: [N, 3] rad, of the joints.
            velocity: [N, 3] rad/s, of the joints.
        """
        motions = self._motions(angles)
        position, turn = self._frames(motions)
        axis = turn[..., 2]  # [N, 2, 3]
        to_tool = tool[:, None] - position
        half = jnp.asarray(self.half_length)[None]
        along = jnp.clip((to_tool * axis).sum(-1), -half, half)
        gap = to_tool - along[..., None] * axis
        on_lower = jnp.linalg.norm(gap[:, 1], axis=-1) < jnp.linalg.norm(gap[:, 0], axis=-1)
        outward = unit(jnp.where(on_lower[:, None], gap[:, 1], gap[:, 0]))
        jacobian = self._jacobian(motions, tool, on_lower)
        drift = (tool - before) / STEP - (jacobian * velocity[:, None]).sum(-1)
        drift = drift - (drift * outward).sum(-1, keepdims=True) * outward
        away = unit((jacobian * -outward[:, :, None]).sum(1))
        return away, jnp.linalg.norm(drift, axis=-1)

    def postures(self, most: float) -> dict[str, np.ndarray]:
        """Return postures that the arm can hold without lying inside anything.

        Args:
            most: share of the seat's torque that holding may take; infinite if the robot holds it.

        Returns:
            "angles" [M, 3], "position" [M, 2, 3] of the segments, "turn" [M, 2, 3, 3] from their
            frames to the world, "load" [M], the largest share of a joint's torque that it takes.
        """
        sides = (np.linspace(*bounds, size) for bounds, size in zip(self.range, GRID, strict=True))
        rows: dict[str, list] = {name: [] for name in ("angles", "position", "turn", "load")}
        for angles in itertools.chain([self.rest], itertools.product(*sides)):
            data = self._posed(np.array(angles))
            load = float(np.abs(self._held(data) / self.torque).max())
            if load > most or self._before_face(data) or not self._free(np.array(angles)):
                continue
            frames = data.site_xmat[self._sites].reshape(2, 3, 3)
            values = angles, data.site_xpos[self._sites], frames, load
            for name, value in zip(rows, values, strict=True):
                rows[name].append(np.array(value, np.float32))
        return {name: np.stack(values) for name, values in rows.items()}

    def _posed(self, angles: np.ndarray) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        data.qpos[:] = self._start
        data.qpos[self._qpos] = angles
        mujoco.mj_forward(self.model, data)
        return data

    def _held(self, data: mujoco.MjData) -> np.ndarray:
        """Return the torques [3] that hold the arm still, its springs' share taken off."""
        return np.array(data.qfrc_bias[self._dofs] - data.qfrc_passive[self._dofs])

    def _free(self, angles: np.ndarray) -> bool:
        """Return whether nothing is in the way from rest to a posture."""
        shares = np.linspace(0.0, 1.0, PLACES + 1)[1:]
        return all(self._depth(self.rest + share * (angles - self.rest)) < DEEP for share in shares)

    def _depth(self, angles: np.ndarray) -> float:
        """Return how deep the arm is in anything, m; forces are not computed."""
        data = self._scratch
        data.qpos[self._qpos] = angles
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_collision(self.model, data)
        of_arm = np.isin(data.contact.geom, self._parts).any(axis=1)
        return -float(data.contact.dist[of_arm].min(initial=0.0))

    def _before_face(self, data: mujoco.MjData) -> bool:
        forearm = data.site_xpos[self._sites[-1]]
        head = data.geom_xpos[self.model.geom("human_head").id]
        return float(np.linalg.norm(forearm - head)) < FACE

    def _motions(self, angles: jax.Array) -> "list[_Motion]":
        """Return the motion that the first joint causes, the first two together, and all three."""
        angle = angles[:, :, None, None]  # [N, 3, 1, 1]
        turns = (
            jnp.eye(3)[None, None]
            + jnp.sin(angle) * jnp.asarray(self._cross)[None]
            + (1.0 - jnp.cos(angle)) * jnp.asarray(self._cross @ self._cross)[None]
        )
        motions: list[_Motion] = []
        for place, anchor in enumerate(self._anchor):
            own = _Motion(turns[:, place], jnp.zeros((1, 3)))
            own = _Motion(own.turn, anchor[None] - own.moved(anchor))
            motions.append(motions[-1].after(own) if motions else own)
        return motions

    def _frames(self, motions: "list[_Motion]") -> tuple[jax.Array, jax.Array]:
        """Return positions and frames of both segments as of `frames`."""
        by_segment = motions[JOINTS - 2 :]
        position = [motion.moved(of) for motion, of in zip(by_segment, self._position, strict=True)]
        turn = [
            _times(motion.turn, of[None])
            for motion, of in zip(by_segment, self._frame, strict=True)
        ]
        return jnp.stack(position, axis=1), jnp.stack(turn, axis=1)

    def _placed(self, motions: "list[_Motion]") -> list[tuple[jax.Array, jax.Array]]:
        """Return anchor and axis [N, 3] of each joint in the world: those before it turn it."""
        placed = [(jnp.asarray(self._anchor[:1]), jnp.asarray(self._axis[:1]))]
        for motion, anchor, axis in zip(motions, self._anchor[1:], self._axis[1:], strict=False):
            placed.append((motion.moved(anchor), _times(motion.turn, axis[None, :, None])[..., 0]))
        return placed

    def _jacobian(
        self, motions: "list[_Motion]", point: jax.Array, on_lower: jax.Array
    ) -> jax.Array:
        """Return how joints move a point as of `jacobian`."""
        columns = [jnp.cross(axis, point - anchor) for anchor, axis in self._placed(motions)]
        columns[2] = jnp.where(on_lower[:, None], columns[2], 0.0)
        return jnp.stack(columns, axis=-1)

    def _torques(
        self, placed: list[tuple[jax.Array, jax.Array]], centre: jax.Array, weight: float
    ) -> jax.Array:
        """Return the torques [N, 3] of a weight at `centre` that hangs on the joints `placed`."""
        force = np.array([[0.0, 0.0, -1.0]], np.float32) * weight
        columns = [(axis * jnp.cross(centre - anchor, force)).sum(-1) for anchor, axis in placed]
        columns += [jnp.zeros_like(columns[0])] * (JOINTS - len(placed))
        return jnp.stack(columns, axis=-1)


@dataclasses.dataclass(frozen=True)
class _Motion:
    """Rigid motion of each simulation: rotation [N, 3, 3], then shift [N, 3]."""

    turn: jax.Array
    shift: jax.Array

    def moved(self, point: np.ndarray) -> jax.Array:
        """Return the images [N, 3] of a point [3]."""
        return _times(self.turn, point[None, :, None])[..., 0] + self.shift

    def after(self, first: "_Motion") -> "_Motion":
        """Return the motion that is `first` and then this one."""
        shift = _times(self.turn, first.shift[..., None])[..., 0] + self.shift
        return _Motion(_times(self.turn, first.turn), shift)


def _times(turn: jax.Array, columns: jax.Array | np.ndarray) -> jax.Array:
    """Return the images [N, 3, C] of vectors, columns [N, 3, C] or [1, 3, C], under rotations.

    Column by column: a sum over an axis of three took three quarters of a person's time on a CPU.
    """
    first, second, third = (turn[:, :, place, None] * columns[:, None, place] for place in range(3))
    return first + second + third
