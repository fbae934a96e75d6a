"""Scripted robots: the chain of joints that a script drives, and the script of a task.

A script sees what a trained robot sees, and has no memory. Its return with a passive human is what
a task pays without coordination: a task on which it does well says little about partners.

Shapes: N simulations; observations [N, O] of the robot, actions [N, 7].
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.preferences import PREFERRED, WORDS, middles
from assistax_envs.registered import ByTask, load
from assistax_envs.tasks.base import ROBOT_JOINTS, rotate

DOWN = np.array([[0.0, 0.0, -1.0]], np.float32)
Numbers = Mapping[str, Any]
TURN = 0.2  # m, weight of the shaft's direction against the tool's place


class Chain:
    """The robot's joints as constants of a model: anchors, axes and torques."""

    def __init__(self, model: mujoco.MjModel) -> None:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)  # all joints at zero
        joints = [model.joint(name) for name in ROBOT_JOINTS]
        ids = [joint.id for joint in joints]
        self._anchor = np.array(data.xanchor[ids], np.float32)  # [7, 3] m, world
        self._axis = np.array(data.xaxis[ids], np.float32)  # [7, 3]
        addresses = [joint.dofadr[0] for joint in joints]
        gear = [model.actuator(name).gear[0] for name in ROBOT_JOINTS]
        self._damping = np.array(model.dof_damping[addresses], np.float32)  # N m s/rad
        # Damping balances nearly all of a torque: this share of the limit turns a joint at 1 rad/s.
        self._share = np.array(model.dof_damping[addresses] / gear, np.float32)

    def jacobian(self, angles: jax.Array, point: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the Jacobians of a point [N, 3] of the hand: of its position, and of rotation.

        [N, 3, 7] each, by the product of exponentials: a joint's axis is turned by those before it.
        A loop over the joints: unrolled, it was half of what a rollout with a script compiles.
        """
        n = angles.shape[0]

        def add(
            before: tuple[jax.Array, jax.Array], joint: tuple[jax.Array, ...]
        ) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
            (turned, moved), (angle, *own) = before, joint
            own_anchor, own_axis = (jnp.broadcast_to(of, (n, 3)) for of in own)
            anchor, axis = moved + rotate(turned, own_anchor), rotate(turned, own_axis)
            half = 0.5 * angle[:, None]
            turn = jnp.concatenate([jnp.cos(half), axis * jnp.sin(half)], axis=-1)
            turned = _multiply(turn, turned)
            moved = anchor - rotate(turned, own_anchor)
            return (turned, moved), (jnp.cross(axis, point - anchor), axis)

        still = jnp.zeros((n, 4)).at[:, 0].set(1.0), jnp.zeros((n, 3))
        joints = angles.T, jnp.asarray(self._anchor), jnp.asarray(self._axis)
        _, (linear, angular) = jax.lax.scan(add, still, joints)
        return jnp.moveaxis(linear, 0, -1), jnp.moveaxis(angular, 0, -1)

    def velocity(self, obs: jax.Array) -> jax.Array:
        """Return the tool's velocity [N, 3], m/s."""
        linear, _ = self.jacobian(obs[:, :7], obs[:, 14:17])
        return jnp.einsum("nij,nj->ni", linear, obs[:, 7:14])

    def yields(self, obs: jax.Array, normal: jax.Array) -> jax.Array:
        """Return the speed [N, 1] at which 1 N along `normal` [N, 3] moves the tool, m/s.

        A tool that is driven at a speed and does not move presses by the speed over this.
        """
        linear, _ = self.jacobian(obs[:, :7], obs[:, 14:17])
        turns = jnp.einsum("ni,nij->nj", normal, linear)
        return (turns**2 / self._damping[None]).sum(axis=1, keepdims=True)

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
        shaft to itself. With more `damping`, m^2, a stretched arm gives up rather than swings. An
        `upright` tool has its x axis turned up.
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


@dataclasses.dataclass(frozen=True)
class Script:
    """Script of a task.

    Attributes:
        play: From the chain, the script's numbers and observations to actions.
        numbers: Numbers that it plays by; the best of a search with persons
            (`assistax-zoo gates persons TASK --only search`).
        ranges: Least and largest value that a search tries of each number.
        told: From the numbers of a script that is told the wishes, and the wishes [N, 1] by name,
            to the numbers that keep to them; None if it cannot be told.
        careful: Numbers of a script that is told, in place of its own.
    """

    play: Callable[[Chain, Numbers, jax.Array], jax.Array]
    numbers: Mapping[str, float] = dataclasses.field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    told: Callable[[Numbers, Mapping[str, jax.Array]], Numbers] | None = None
    careful: Mapping[str, float] = dataclasses.field(default_factory=dict)


SCRIPTS: Mapping[str, Script] = ByTask(lambda kind: load(kind.script))


def script_of(
    task: str, model: mujoco.MjModel, numbers: Numbers | None = None
) -> Callable[[jax.Array], jax.Array]:
    """Return a task's script: from observations [N, O] of the robot to actions [N, 7].

    Args:
        task: The task.
        model: Model of its scene.
        numbers: Numbers that replace some of the script's own.
    """
    script = SCRIPTS[task]
    chosen = {**script.numbers, **(numbers or {})}
    # Compiled once where it is called by itself; a program that contains it is as without.
    return jax.jit(functools.partial(script.play, Chain(model), chosen), inline=True)


def told_script_of(
    task: str, model: mujoco.MjModel, numbers: Numbers | None = None
) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Return a task's script that keeps to wishes.

    Its arguments are observations [N, O] of the robot and the wishes [N, W], in the order of the
    task's preferences. Other wishes than the human's make a robot that is wrong on purpose.

    Args:
        task: The task.
        model: Model of its scene.
        numbers: Numbers that replace some of the script's own.

    Raises:
        ValueError: The task's script cannot be told.
    """
    script, chain = SCRIPTS[task], Chain(model)
    if script.told is None:
        able = ", ".join(name for name, other in SCRIPTS.items() if other.told)
        raise ValueError(f"the script of {task} cannot be told wishes; those of {able} can")
    told, chosen = script.told, {**script.numbers, **script.careful, **(numbers or {})}

    @functools.partial(jax.jit, inline=True)
    def act(obs: jax.Array, wishes: jax.Array) -> jax.Array:
        named = dict(zip(PREFERRED[task], jnp.split(wishes, wishes.shape[1], axis=1), strict=True))
        return script.play(chain, {**chosen, **told(chosen, named)}, obs)

    return act


def observed_wishes(task: str, obs: jax.Array) -> jax.Array:
    """Return the wishes [N, W] in observations of a robot that is told them."""
    middle = jnp.array([middles(task)])
    last = obs.shape[-1] - len(WORDS)
    return middle * jnp.exp(obs[:, last - middle.shape[1] : last])


def capped(vector: jax.Array, most: float | jax.Array) -> jax.Array:
    """Return vectors [N, 3], shortened to at most `most`."""
    length = jnp.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * jnp.minimum(1.0, most / jnp.maximum(length, 1e-9))


def down(obs: jax.Array) -> jax.Array:
    """Return the direction downwards [N, 3] for each row of observations."""
    return jnp.broadcast_to(DOWN, (obs.shape[0], 3))


def _multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the product of quaternions [N, 4] (w, x, y, z): first `b`, then `a`."""
    w1, u1, w2, u2 = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    w = w1 * w2 - (u1 * u2).sum(-1, keepdims=True)
    return jnp.concatenate([w, w1 * u2 + w2 * u1 + jnp.cross(u1, u2)], axis=-1)
