"""The body of a visitor: a person whose intention comes from outside, from a mouse or a finger.

The muscles are those of the family `spring`, without delay, noise, tremor or fatigue. A visitor
says where the hand should be, or how head and jaw should turn; the body goes there as fast as
people move. Shapes: N simulations.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.persons.controller import LIMP, Controller
from assistax_envs.persons.head import Head
from assistax_envs.persons.rows import FAMILIES
from assistax_envs.persons.senses import sense
from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.gentle_base import STEP

FASTEST = 3.0  # rad/s, of an intended joint of the arm
TURNS = np.array([0.6, 1.5, 1.5, 1.5, 4.0], np.float32)  # rad/s, of trunk, neck and jaw
DAMPED = 0.05  # m, of inverse kinematics: what an arm that is stretched out gives up
TRIES = 3  # steps of inverse kinematics in a control step
FOLLOWS = 0.4  # s, in which a relaxed arm's intention becomes the posture that it has
# Numbers of a person as `common.numbers_of` names them, without what a visitor's own body does.
NUMBERS = {
    "strength": 1.0,
    "stiffness": 1.2,
    "gravity": 1.0,
    "delay": 0.0,
    "settle": 0.3,
    "catch_speed": 1.0,
    "bite_onset": 4.0,
    "tremor_frequency": 8.0,
    "family": float(FAMILIES.index("spring")),
    **dict.fromkeys(("noise", "tremor", "spasticity", "bite_reflex", "wander", "fatigue"), 0.0),
}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Body:
    """The carry of a visitor; every leaf has axis N first."""

    intended: jax.Array  # [N, J] rad
    effort: jax.Array  # [N, 3] N m, smoothed torque of the arm; zeros at the mouth


class Visitor:
    """Bodies of visitors in a task: from what they point at to actions of the human's seat."""

    def __init__(self, task: str, model: mujoco.MjModel) -> None:
        self.task = task
        self.at_mouth = REGISTERED[task].seat == "mouth"
        made: Any = Head if self.at_mouth else Controller
        self._controller: Any = made(task, model)
        # Arm: where the hand should be, m, and 1 for an arm that is held, 0 for one that rests.
        # Head: angles of trunk, pitch, yaw, roll and jaw, rad.
        self.pointer_size = 5 if self.at_mouth else 4

    def initial(self, obs: jax.Array) -> Body:
        """Return the carry for the first observations [N, O] of the human."""
        now = self._posture(obs)
        return Body(now, jnp.zeros((obs.shape[0], 3), jnp.float32))

    def act(self, body: Body, obs: jax.Array, pointer: jax.Array) -> tuple[Body, jax.Array]:
        """Return the carry and the actions [N, 3], at the mouth [N, 5].

        Args:
            body: The carry.
            obs: [N, O] what a human in the seat observes.
            pointer: [N, `pointer_size`] what the visitor points at.
        """
        n = obs.shape[0]
        numbers = {name: jnp.full(n, value, jnp.float32) for name, value in NUMBERS.items()}
        mind, still = self._controller.initial(n), jnp.zeros((n, pointer.shape[1]), jnp.float32)
        if self.at_mouth:
            now = self._posture(obs)
            late = jnp.concatenate([now, still], axis=1)  # feels nothing that bites could follow
            most = STEP * jnp.asarray(TURNS)[None]
            intended = body.intended + jnp.clip(pointer - body.intended, -most, most)
            mind = dataclasses.replace(mind, intended=intended)
            mind, action = self._controller.move(mind, now, late, numbers, still)
            return Body(intended, body.effort), action
        senses, held = sense(self.task, obs), pointer[:, 3]
        intended = jnp.where(
            (held > 0.5)[:, None],
            self._reached(body.intended, pointer[:, :3]),
            body.intended + STEP / FOLLOWS * (senses.position - body.intended),
        )
        tone = jnp.where(held > 0.5, 1.0, LIMP)
        mind = dataclasses.replace(mind, intended=intended, tone=tone, effort=body.effort)
        given = mind, senses, senses.position, numbers, numbers["strength"], still[:, :3]
        mind, action = self._controller.move(*given)
        return Body(intended, mind.effort), action

    def place(self, body: Body, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return what pictures of the body need.

        Returns:
            Of an arm the hand's place [N, 3] and the intended one, m; of a head its posture [N, 5]
            and the intended one, rad.
        """
        now = self._posture(obs)
        if self.at_mouth:
            return now, body.intended
        return self._controller.arm.hand(now), self._controller.arm.hand(body.intended)

    def _posture(self, obs: jax.Array) -> jax.Array:
        if self.at_mouth:
            return obs[:, self._controller.joints_read]
        return sense(self.task, obs).position

    def _reached(self, angles: jax.Array, hand: jax.Array) -> jax.Array:
        """Return angles [N, 3] at which the hand is nearer to a place [N, 3], or the same angles.

        What is out of reach makes no arm swing: a step that brings nothing is not taken.
        """
        arm = self._controller.arm
        low, high = jnp.asarray(arm.range.T)[:, None]
        most, lower = STEP * FASTEST / TRIES, jnp.ones(angles.shape[0], bool)
        off = hand - arm.hand(angles)
        for _ in range(TRIES):
            turns = arm.jacobian(angles, hand - off, lower)  # [N, 3, 3]
            square = jnp.einsum("nij,nkj->nik", turns, turns) + DAMPED**2 * jnp.eye(3)[None]
            # Newton's step, and down the slope, which leads along a joint's limit too.
            for way in (_solved(square, off), off / DAMPED**2):
                change = jnp.einsum("nij,ni->nj", turns, way)
                fastest = jnp.abs(change).max(axis=1, keepdims=True)
                change = change * jnp.minimum(1.0, most / jnp.maximum(fastest, 1e-9))
                tried = jnp.clip(angles + change, low, high)
                left = hand - arm.hand(tried)
                nearer = ((left**2).sum(-1) < (off**2).sum(-1))[:, None]
                angles, off = jnp.where(nearer, tried, angles), jnp.where(nearer, left, off)
        return angles


def _solved(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Return the solution [N, 3] of equations with symmetric matrices [N, 3, 3], by Cramer."""
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    turned = jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)
    size = (a * turned[0]).sum(-1, keepdims=True)
    parts = [(right[:, i : i + 1] * turned[i]) for i in range(3)]
    return (parts[0] + parts[1] + parts[2]) / size
