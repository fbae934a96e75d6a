"""Vectors, matrices and quaternions of scalars that are run-time values or constants."""

import mujoco
import numpy as np

from assistax_envs.physics.fused.expressions import (
    Matrix,
    Scalar,
    Vector,
    multiply_add,
    multiply_subtract,
)

ZERO: Vector = (0.0, 0.0, 0.0)


def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return [x + y for x, y in zip(a, b, strict=True)]


def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return [x - y for x, y in zip(a, b, strict=True)]


def scale(s: Scalar, a: Vector) -> Vector:
    """Return s a."""
    return [s * x for x in a]


def add_scaled(a: Vector, s: Scalar, b: Vector) -> Vector:
    """Return a + s b."""
    return [multiply_add(s, y, x) for x, y in zip(a, b, strict=True)]


def dot(a: Vector, b: Vector, start: Scalar = 0.0) -> Scalar:
    """Return start + a . b."""
    for x, y in zip(a, b, strict=True):
        start = multiply_add(x, y, start)
    return start


def cross(a: Vector, b: Vector, start: Vector = ZERO) -> Vector:
    """Return start + a x b."""
    return [
        multiply_subtract(a[k - 1], b[k - 2], multiply_add(a[k - 2], b[k - 1], start[k]))
        for k in range(3)
    ]


def rotate(rotation: Matrix, v: Vector, start: Vector = ZERO) -> Vector:
    """Return start + rotation v."""
    return [dot(row, v, s) for row, s in zip(rotation, start, strict=True)]


def product(a: Matrix, b: Matrix) -> Matrix:
    """Return the matrix product a b."""
    return [[dot(row, column) for column in zip(*b, strict=True)] for row in a]


def quaternion_product(a: Vector, b: Vector) -> Vector:
    """Return the Hamilton product of quaternions (w, x, y, z)."""
    w, x, y, z = a
    return [
        dot([w, -x, -y, -z], b),
        dot([x, w, -z, y], b),
        dot([y, z, w, -x], b),
        dot([z, -y, x, w], b),
    ]


def quaternion_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a constant unit quaternion."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, float))
    return tidy(matrix.reshape(3, 3))


def tidy(array: np.ndarray) -> np.ndarray:
    """Return the array with rounding errors about 0, 1 and -1 removed, so that they fold away."""
    nearest = np.round(array)
    return np.where((np.abs(array - nearest) < 1e-12) & (np.abs(nearest) <= 1), nearest, array)
