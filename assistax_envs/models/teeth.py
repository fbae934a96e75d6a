"""Twelve places on the teeth, and a brush's position for each, in the mouth's frame.

Rows are right, front and left, above and below, outside and inside. The lower ones go with the jaw.
"""

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.models.care_scenes import (
    JAW,
    LOWER_TEETH,
    MOUTH,
    ROWS,
    TEETH,
    TOOTH_SIZE,
    UPPER_TEETH,
)

BRUSH_SIZE = 0.005  # m, the radius of the brush's head
OFF = BRUSH_SIZE + TOOTH_SIZE - 0.001  # m, from a row's axis to that of a brush that presses
# The order in which they are brushed, from any of them on: outside around, then inside.
ORDER = (
    ("upper", "right", False),
    ("upper", "front", False),
    ("upper", "left", False),
    ("lower", "left", False),
    ("lower", "front", False),
    ("lower", "right", False),
    ("lower", "right", True),
    ("lower", "front", True),
    ("lower", "left", True),
    ("upper", "left", True),
    ("upper", "front", True),
    ("upper", "right", True),
)
PLACES = len(ORDER)
INNER = np.array([inner for _, _, inner in ORDER])
LOWER = np.array([jaw == "lower" for jaw, _, _ in ORDER])
ROW = np.array([TEETH.index(f"{jaw}_{side}_teeth") for jaw, side, _ in ORDER])
# Which way the head turns to show them: left, +1, for the right side.
SHOWN_BY = np.array([{"right": 1.0, "front": 0.0, "left": -1.0}[side] for _, side, _ in ORDER])
HINGE = np.subtract(JAW, MOUTH).astype(np.float32)


def _laid_out() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return middle, direction and outward normal of all places [12, 3], with the jaw closed."""
    middles, along, normals = [], [], []
    for jaw, side, inner in ORDER:
        height = UPPER_TEETH if jaw == "upper" else LOWER_TEETH
        ends = np.array([(*end, height) for end in ROWS[side]]) - MOUTH
        way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        out = np.cross(way, [0.0, 0.0, 1.0])
        # Inside a brush comes from between the rows: at 45 degrees.
        below = -1.0 if jaw == "upper" else 1.0
        normal = np.sqrt(0.5) * (np.array([0.0, 0.0, below]) - out) if inner else out
        middles.append(ends.mean(axis=0))
        along.append(way)
        normals.append(normal)
    return np.array(middles, np.float32), np.array(along, np.float32), np.array(normals, np.float32)


MIDDLE, ALONG, NORMAL = _laid_out()


def with_jaw(vector: jax.Array, jaw: jax.Array, lower: jax.Array) -> jax.Array:
    """Turn directions [N, 3] of the mouth's frame with the jaw [N], where they are `lower` [N]."""
    angle = jnp.where(lower, jaw, 0.0)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y, z = vector[:, 0], vector[:, 1], vector[:, 2]
    return jnp.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def places(number: jax.Array, jaw: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return middle, direction and normal [N, 3] of places `number` [N], in the mouth's frame."""
    lower = jnp.asarray(LOWER)[number]
    middle = with_jaw(jnp.asarray(MIDDLE)[number] - HINGE[None], jaw, lower) + HINGE[None]
    along = with_jaw(jnp.asarray(ALONG)[number], jaw, lower)
    return middle, along, with_jaw(jnp.asarray(NORMAL)[number], jaw, lower)
