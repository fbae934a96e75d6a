"""What a person makes of a human's observation: the same few things in every task.

Everything that a person reacts to is observed: its joints, the tool, the force of all touches. How
fast something slides over its skin it feels from how tool and arm move. Its wishes it knows: those
in the observation are of the episode, and are not looked at.

Shapes: N simulations.
"""

import dataclasses
from itertools import accumulate

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.tasks.base import HUMAN_ACTUATORS, HUMAN_JOINTS

# Of a human's observation, in its order: what it begins with in all tasks, and each task's goal.
_COMMON = (
    ("position", len(HUMAN_JOINTS)),
    ("velocity", len(HUMAN_JOINTS)),
    ("tool", 3),
    ("orientation", 4),
    ("force", 3),
    ("lower_arm", 3),
    ("upper_arm", 3),
    ("towards", 3),
    ("distance", 1),
)
LAYOUT: dict[str, tuple[tuple[str, int], ...]] = {
    "scratch": _COMMON,
    "bed_bath": _COMMON,
    "arm_assist": (*_COMMON, ("turn", 9), ("to_place", 3), ("left", 1)),
    "gentle_scratch": (
        *_COMMON,
        ("fine", 3),
        ("outward", 3),
        ("slip", 3),
        ("touch", 1),
        ("time", 1),
        ("strokes", 1),
        ("known", 3),
    ),
    "gentle_bath": (
        *_COMMON[:-1],
        ("outward", 3),
        ("distance", 1),
        ("touch", 1),
        ("sliding", 1),
        ("unwiped", 25),
        ("known", 2),
    ),
    "gentle_lift": (
        *_COMMON,
        ("to_place", 3),
        ("left", 1),
        ("touch", 1),
        ("swing", 1),
        ("known", 3),
    ),
}
# Where in a human's observation the parts stand that a person at the mouth reads.
AT_MOUTH: dict[str, dict[str, slice]] = {
    "gentle_feeding": {
        "tool": slice(30, 33), "progress": slice(37, 42), "touch": slice(45, 46),
        "closed": slice(42, 43),
    },
    "gentle_brushing": {
        "tool": slice(30, 33), "progress": slice(50, 62), "touch": slice(67, 68),
        "closed": slice(63, 64),
    },
}  # fmt: skip
# Width of that observation, and torques.
SEAT_SIZES = {task: (sum(width for _, width in parts), 3) for task, parts in LAYOUT.items()} | {
    "gentle_feeding": (50, 5),
    "gentle_brushing": (72, 5),
}
MOUTH_UNIT = {"gentle_feeding": 10.0, "gentle_brushing": 5.0}  # N of an observed touch of 1
TOUCH_UNIT = 10.0  # N of an observed touch of 1
_ARM = np.array([HUMAN_JOINTS.index(joint) for joint in HUMAN_ACTUATORS])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Senses:
    """What a person perceives now; its delay comes later."""

    position: jax.Array  # [N, 3] rad, of the right arm's joints
    velocity: jax.Array  # [N, 3] rad/s
    tool: jax.Array  # [N, 3] m
    force: jax.Array  # [N] N, of all that touches
    target: jax.Array  # [N, 3] m: the itch, the next point, or the middle of the forearm
    unwiped: jax.Array  # [N, K] 1 where a point is left to wipe; K is 0 in other tasks
    to_place: jax.Array  # [N, 3] m from the forearm's middle to its place; 0 in other tasks
    distance: jax.Array  # [N] m from the tool to the target


def columns(task: str) -> dict[str, slice]:
    """Return where in a human's observation of a task each part stands."""
    names, widths = zip(*LAYOUT[task], strict=True)
    ends = accumulate(widths)
    return {n: slice(e - w, e) for n, w, e in zip(names, widths, ends, strict=True)}


def sense(task: str, obs: jax.Array) -> Senses:
    """Read observations [N, O] of the human in a task."""
    parts = {name: obs[:, where] for name, where in columns(task).items()}
    if "touch" in parts:
        force = TOUCH_UNIT * parts["touch"][:, 0]
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
    )
