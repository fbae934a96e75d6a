"""A person's right arm as constants of a scene: joints, weights and possible postures.

Shapes: N simulations, M postures; joints are those of `HUMAN_ACTUATORS`: two of the shoulder, the
elbow. The trunk counts as resting: it bends by hundredths of a radian.
"""

import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks.base import ARM_SEGMENTS, HUMAN_ACTUATORS, ROBOT_JOINTS

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
        self.half_length = np.array([site.size[1] for site in sites], np.float32)  # [2] m
        self.radius = np.array([site.size[0] for site in sites], np.float32)  # [2] m

    def frames(self, angles: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return positions [N, 2, 3] and frames [N, 2, 3, 3] of both segments, z along each."""
        turns = self._turns(angles)
        position, turn = [], []
        for segment, count in enumerate((JOINTS - 1, JOINTS)):
            position.append(_moved(self._position[segment], turns[:count]))
            columns = [
                _turned(self._frame[segment, :, column], turns[:count]) for column in range(3)
            ]
            turn.append(jnp.stack(columns, axis=-1))
        return jnp.stack(position, axis=1), jnp.stack(turn, axis=1)

    def gravity(self, angles: jax.Array) -> jax.Array:
        """Return the torques [N, 3] that hold the arm's weight at joint angles [N, 3]."""
        turns = self._turns(angles)
        upper = _moved(self._centre[0], turns[:2])
        lower = _moved(self._centre[1], turns)
        return -(
            self._torques(turns, upper, self._weight[0], 2)
            + self._torques(turns, lower, self._weight[1], 3)
        )

    def jacobian(self, angles: jax.Array, point: jax.Array, on_lower: jax.Array) -> jax.Array:
        """Return how joints move a point [N, 3] of the arm, [N, 3, 3]: metres by joint.

        The elbow moves what is `on_lower` [N] alone.
        """
        columns = [
            jnp.cross(axis, point - anchor) for anchor, axis in self._placed(self._turns(angles))
        ]
        columns[2] = jnp.where(on_lower[:, None], columns[2], 0.0)
        return jnp.stack(columns, axis=-1)

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

    def _turns(self, angles: jax.Array) -> list[tuple[jax.Array, jax.Array]]:
        """Return each joint's own motion, rotation [N, 3, 3] and shift [N, 3], about its place."""
        turns = []
        for place in range(JOINTS):
            axis, anchor = self._axis[place], jnp.asarray(self._anchor[place])
            cross = np.array(
                [[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]], np.float32
            )
            angle = angles[:, place, None, None]
            turn = (
                jnp.eye(3)[None]
                + jnp.sin(angle) * jnp.asarray(cross)[None]
                + (1.0 - jnp.cos(angle)) * jnp.asarray(cross @ cross)[None]
            )
            turns.append((turn, anchor[None] - _apply(turn, anchor[None])))
        return turns

    def _placed(
        self, turns: list[tuple[jax.Array, jax.Array]]
    ) -> list[tuple[jax.Array, jax.Array]]:
        """Return anchor and axis [N, 3] of each joint in the world: those before it turn it."""
        placed = []
        for place in range(JOINTS):
            anchor = _moved(self._anchor[place], turns[:place])
            placed.append((anchor, _turned(self._axis[place], turns[:place])))
        return placed

    def _torques(
        self,
        turns: list[tuple[jax.Array, jax.Array]],
        centre: jax.Array,
        weight: float,
        joints: int,
    ) -> jax.Array:
        """Return the torques [N, 3] of a weight at `centre` that hangs on the first joints."""
        force = np.array([[0.0, 0.0, -1.0]], np.float32) * weight
        columns = [
            (axis * jnp.cross(centre - anchor, force)).sum(-1)
            for anchor, axis in self._placed(turns)[:joints]
        ]
        columns += [jnp.zeros_like(columns[0])] * (JOINTS - joints)
        return jnp.stack(columns, axis=-1)


def _moved(point: np.ndarray, turns: list[tuple[jax.Array, jax.Array]]) -> jax.Array:
    """Return the images [N, 3] of a point [3] under the joints' motions, the last joint's first."""
    moved = jnp.asarray(point)[None]
    for turn, shift in reversed(turns):
        moved = _apply(turn, moved) + shift
    return moved


def _turned(vector: np.ndarray, turns: list[tuple[jax.Array, jax.Array]]) -> jax.Array:
    """Return the images [N, 3] of a direction [3] under the joints' rotations."""
    turned = jnp.asarray(vector)[None]
    for turn, _ in reversed(turns):
        turned = _apply(turn, turned)
    return turned


def _apply(turn: jax.Array, vector: jax.Array) -> jax.Array:
    """Return a rotation's image of a vector, [N, 3].

    Column by column: a sum over an axis of three took three quarters of a person's time on a CPU.
    """
    first, second, third = (turn[..., place] * vector[:, None, place] for place in range(3))
    return first + second + third
