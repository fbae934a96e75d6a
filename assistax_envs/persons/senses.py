"""Perception of a person with an arm: the same few quantities from every task's observation.

The human's observation holds all that a person reacts to: its joints, the tool, the force of all
touches. Sliding over its skin follows from the motion of tool and arm. A person has its own
preference, and ignores the observed one.

Shapes: N simulations.
"""

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.persons.rows import person_kind
from assistax_envs.preferences import PREFERRED
from assistax_envs.registered import ByTask
from assistax_envs.tasks.base import HUMAN_ACTUATORS, HUMAN_JOINTS

# Width of the human's observation and number of its torques, by task.
SEAT_SIZES: Mapping[str, tuple[int, int]] = ByTask(
    lambda kind: person_kind(kind.name).seat_size, lambda kind: kind.person is not None
)
_ARM = np.array([HUMAN_JOINTS.index(joint) for joint in HUMAN_ACTUATORS])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Senses:
    """Perception of a person now, before its delay."""

    position: jax.Array  # [N, 3] rad, of the right arm's joints
    velocity: jax.Array  # [N, 3] rad/s
    tool: jax.Array  # [N, 3] m
    force: jax.Array  # [N] N, of all that touches
    target: jax.Array  # [N, 3] m: the itch, the next point, or the middle of the forearm
    unwiped: jax.Array  # [N, K] 1 where a point is left to wipe; K is 0 in other tasks
    to_place: jax.Array  # [N, 3] m from the forearm's middle to its place; 0 in other tasks
    distance: jax.Array  # [N] m from the tool to the target
    felt: jax.Array  # [N, 2W] of each wish, what is done over its middle, and whether it is judged


def sense(task: str, obs: jax.Array) -> Senses:
    """Read observations [N, O] of the human in a task."""
    person = person_kind(task)
    parts = {name: obs[:, where] for name, where in person.columns.items()}
    if "touch" in parts:
        force = person.touch_unit * parts["touch"][:, 0]
    else:  # of the tool on the arm: the paper's tasks feel no other
        force = jnp.linalg.norm(parts["force"], axis=-1)
    n = obs.shape[0]
    return Senses(
        position=parts["position"][:, _ARM],
        velocity=parts["velocity"][:, _ARM],
        tool=parts["tool"],
        force=force,
        target=parts["tool"] + parts["towards"],
        unwiped=parts.get("unwiped", jnp.zeros((n, 0), obs.dtype)),
        to_place=parts.get("to_place", jnp.zeros((n, 3), obs.dtype)),
        distance=jnp.linalg.norm(parts["towards"], axis=-1),
        felt=parts["felt"] if task in PREFERRED else jnp.zeros((n, 0), obs.dtype),
    )
