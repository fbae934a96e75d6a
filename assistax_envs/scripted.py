"""Scripted robots: a few lines for each task that drive the tool to its target.

What such a script earns with a passive human is what a task pays without coordination: a task on
which it does well says little about partners. It sees what a trained robot sees, and has no memory.

Shapes: N simulations; observations [N, O] of the robot, actions [N, 7].
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.base import ROBOT_JOINTS, rotate

DOWN = np.array([[0.0, 0.0, -1.0]], np.float32)
UNDER = 0.045 * DOWN  # m, from the middle of the forearm to where the bar carries it
TURN = 0.2  # m, weight of the shaft's direction against the tool's place


class Chain:
    """The robot's joints as constants of a model: where they are and how they turn."""

    def __init__(self, model: mujoco.MjModel) -> None:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)  # all joints at zero
        joints = [model.joint(name) for name in ROBOT_JOINTS]
        ids = [joint.id for joint in joints]
        self._anchor = np.array(data.xanchor[ids], np.float32)  # [7, 3] m, world
        self._axis = np.array(data.xaxis[ids], np.float32)  # [7, 3]
        addresses = [joint.dofadr[0] for joint in joints]
        gear = [model.actuator(name).gear[0] for name in ROBOT_JOINTS]
        # Damping balances nearly all of a torque: this share of the limit turns a joint at 1 rad/s.
        self._share = np.array(model.dof_damping[addresses] / gear, np.float32)

    def jacobian(self, angles: jax.Array, point: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return how joints [N, 7] move a point [N, 3] of the hand, and turn the hand.

        [N, 3, 7] each, by the product of exponentials: a joint's axis is turned by those before it.
        """
        turned = jnp.zeros((angles.shape[0], 4)).at[:, 0].set(1.0)
        moved = jnp.zeros((angles.shape[0], 3))
        linear, angular = [], []
        for i in range(len(ROBOT_JOINTS)):
            anchor = moved + rotate(turned, jnp.broadcast_to(self._anchor[i], moved.shape))
            axis = rotate(turned, jnp.broadcast_to(self._axis[i], moved.shape))
            linear.append(jnp.cross(axis, point - anchor))
            angular.append(axis)
            half = 0.5 * angles[:, i : i + 1]
            turned = _multiply(
                jnp.concatenate([jnp.cos(half), axis * jnp.sin(half)], axis=-1), turned
            )
            moved = anchor - rotate(turned, jnp.broadcast_to(self._anchor[i], moved.shape))
        return jnp.stack(linear, axis=-1), jnp.stack(angular, axis=-1)

    def velocity(self, obs: jax.Array) -> jax.Array:
        """Return the tool's velocity [N, 3], m/s."""
        linear, _ = self.jacobian(obs[:, :7], obs[:, 14:17])
        return jnp.einsum("nij,nj->ni", linear, obs[:, 7:14])

    def drive(
        self,
        obs: jax.Array,
        velocity: jax.Array,
        shaft: jax.Array,
        turn: float | jax.Array = TURN,
        damping: float | jax.Array = 1e-4,
        upright: bool = False,
    ) -> jax.Array:
        """Return actions [N, 7] that move and turn the tool.

        At `velocity` [N, 3] m/s, its shaft towards `shaft` [N, 3] with weight `turn`; 0 leaves the
        shaft to itself. With more `damping`, m^2, a stretched arm gives up rather than swings. Who
        keeps the tool `upright` turns its x axis up.
        """
        tool, orientation = obs[:, 14:17], obs[:, 17:21]
        now = rotate(orientation, jnp.broadcast_to(-DOWN, tool.shape))
        linear, angular = self.jacobian(obs[:, :7], tool)
        both = jnp.concatenate([linear, turn * angular], axis=1)
        spin = jnp.cross(now, shaft)
        if upright:
            out_of_bowl = rotate(orientation, jnp.broadcast_to(jnp.eye(3)[0], tool.shape))
            spin = spin + jnp.cross(out_of_bowl, jnp.broadcast_to(-DOWN, tool.shape))
        wanted = jnp.concatenate([velocity, turn * 1.5 * spin], axis=1)
        square = both @ jnp.swapaxes(both, 1, 2) + damping * jnp.eye(6)[None]
        rate = jnp.einsum("nij,ni->nj", both, jnp.linalg.solve(square, wanted[..., None])[..., 0])
        share = rate * self._share[None]
        return share / jnp.maximum(1.0, jnp.abs(share).max(axis=1, keepdims=True))


def scripted_robot(task: str, model: mujoco.MjModel) -> Callable[[jax.Array], jax.Array]:
    """Return the script of a task: from observations [N, O] of the robot to actions [N, 7]."""
    return jax.tree_util.Partial(SCRIPTS[task], Chain(model))


def go(chain: Chain, obs: jax.Array) -> jax.Array:
    """Scratch and bed bath: to the target by the shortest way, and stay."""
    return chain.drive(obs, capped(6.0 * obs[:, 30:33], 0.8), _down(obs), turn=0.0, damping=1e-3)


def lift(chain: Chain, obs: jax.Array) -> jax.Array:
    """Arm assist: the bar under the forearm, then with it to the waist."""
    to_section, distance, to_waist = obs[:, 30:33], obs[:, 33:34], obs[:, 43:46]
    under = to_section + UNDER
    carry = capped(4.0 * to_waist, 0.5) + 2.0 * to_section
    return chain.drive(obs, jnp.where(distance < 0.08, carry, capped(4.0 * under, 0.3)), _down(obs))


# Scripts of the paper's tasks; `assistax_envs.gentle_scripts` has the others.
SCRIPTS: dict[str, Callable[[Chain, jax.Array], jax.Array]] = {
    name: globals()[task.script] for name, task in REGISTERED.items() if task.paper
}


def capped(vector: jax.Array, most: float | jax.Array) -> jax.Array:
    """Return vectors [N, 3], none longer than `most`."""
    length = jnp.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * jnp.minimum(1.0, most / jnp.maximum(length, 1e-9))


def _down(obs: jax.Array) -> jax.Array:
    return jnp.broadcast_to(DOWN, (obs.shape[0], 3))


def _multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the product of quaternions [N, 4] (w, x, y, z): first `b`, then `a`."""
    w1, u1, w2, u2 = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    w = w1 * w2 - (u1 * u2).sum(-1, keepdims=True)
    return jnp.concatenate([w, w1 * u2 + w2 * u1 + jnp.cross(u1, u2)], axis=-1)
