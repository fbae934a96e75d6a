"""Joint-space inertia and bias forces: composite rigid bodies and recursive Newton-Euler.

Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6; in world axes about the
tree's origin, see `kinematics`.
"""

import dataclasses

import numpy as np

from assistax_envs.physics.fused.expressions import (
    Matrix,
    Scalar,
    Vector,
    is_constant,
    multiply_add,
    multiply_subtract,
)
from assistax_envs.physics.fused.kinematics import Motion, Pose
from assistax_envs.physics.fused.tree import Link, Tree, offset_inertia
from assistax_envs.physics.fused.vectors import (
    ZERO,
    add,
    cross,
    dot,
    product,
    rotate,
    scale,
    subtract,
)

Entries = dict[tuple[int, int], Scalar]  # of a symmetric matrix, by (dof, one that carries it)
Force = tuple[Vector, Vector]  # moment about the tree's origin, force


@dataclasses.dataclass(frozen=True)
class Inertia:
    """A spatial inertia about the tree's origin; zero where `mass` is."""

    mass: float = 0.0
    moment: Vector = ZERO  # mass times centre of mass
    tensor: Vector = (0.0,) * 6  # xx, yy, zz, xy, xz, yz of the rotational inertia

    def __add__(self, other: "Inertia") -> "Inertia":
        return Inertia(
            self.mass + other.mass, add(self.moment, other.moment), add(self.tensor, other.tensor)
        )

    def times(self, angular: Vector, linear: Vector) -> Force:
        """Return the momentum of a motion."""
        xx, yy, zz, xy, xz, yz = self.tensor
        spin = rotate([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], angular)
        turned = cross(angular, self.moment)
        force = [multiply_add(self.mass, v, t) for v, t in zip(linear, turned, strict=True)]
        return cross(self.moment, linear, spin), force


def link_inertias(tree: Tree, poses: list[Pose]) -> list[Inertia]:
    """Return every link's own spatial inertia."""
    return [_inertia(link, pose) for link, pose in zip(tree.links, poses, strict=True)]


def _inertia(link: Link, pose: Pose) -> Inertia:
    if link.mass <= 0.0:
        return Inertia()
    centre = link.moment / link.mass
    about_centre = link.inertia - link.mass * offset_inertia(centre)
    x = rotate(pose.rotation, centre.tolist(), pose.position)
    turned = _rotated_tensor(pose.rotation, about_centre)
    moment = scale(link.mass, x)
    squares = [a * b for a, b in zip(moment, x, strict=True)]
    tensor = [turned[k] + (squares[k - 2] + squares[k - 1]) for k in range(3)]
    for value, (a, b) in zip(turned[3:], ((0, 1), (0, 2), (1, 2)), strict=True):
        tensor.append(multiply_subtract(moment[a], x[b], value))
    return Inertia(link.mass, moment, tensor)


def _rotated_tensor(rotation: Matrix, tensor: np.ndarray) -> list[Scalar]:
    """Return xx, yy, zz, xy, xz, yz of rotation tensor rotation^T."""
    half = product(rotation, tensor.tolist())
    indices = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return [dot(half[a], rotation[b]) for a, b in indices]


def inertia_matrix(
    tree: Tree, poses: list[Pose], inertias: list[Inertia], armature: np.ndarray
) -> Entries:
    """Return the joint-space inertia M: each joint moves all that it carries as one rigid body."""
    composite, parents, entries = list(inertias), tree.parents, {}
    for i in reversed(range(len(parents))):
        moment, force = composite[i].times(poses[i].axis, poses[i].moment)
        for link in tree.links[i].chain:
            pose = poses[link.dof]
            entries[i, link.dof] = dot(pose.axis, moment, dot(pose.moment, force))
        entries[i, i] = entries[i, i] + float(armature[i])
        if parents[i] >= 0:
            composite[parents[i]] = composite[parents[i]] + composite[i]
    return entries


def bias_forces(
    tree: Tree,
    poses: list[Pose],
    motions: list[Motion],
    inertias: list[Inertia],
    gravity: np.ndarray,
) -> list[Scalar]:
    """Return the torques under which no joint accelerates: Coriolis forces and gravity."""
    links = zip(tree.links, poses, motions, inertias, strict=True)
    forces = [_bias_force(*link, gravity) for link in links]
    parents = tree.parents
    bias: list[Scalar] = [0.0] * len(parents)
    for i in reversed(range(len(parents))):
        moment, force = forces[i]
        bias[i] = dot(poses[i].axis, moment, dot(poses[i].moment, force))
        if parents[i] >= 0:
            carried = forces[parents[i]]
            forces[parents[i]] = add(carried[0], moment), add(carried[1], force)
    return bias


def _bias_force(
    link: Link, pose: Pose, motion: Motion, inertia: Inertia, gravity: np.ndarray
) -> Force:
    """Return the force on one link: rate of change of its momentum, less its weight."""
    if link.mass <= 0.0:
        return ZERO, ZERO
    spin, momentum = inertia.times(motion.angular, motion.linear)
    moment, force = inertia.times(motion.angular_bias, motion.linear_bias)
    moment = cross(motion.angular, spin, cross(motion.linear, momentum, moment))
    force = cross(motion.angular, momentum, force)
    if is_constant(link.heavy_mass, 0.0) and not link.heavy_moment.any():
        return moment, force
    weight_moment, weight = _weight(link, pose, inertia, gravity)
    return subtract(moment, weight_moment), subtract(force, weight)


def _weight(link: Link, pose: Pose, inertia: Inertia, gravity: np.ndarray) -> Force:
    """Return a link's weight, which acts where the mass is that gravity compensation leaves."""
    share = link.heavy_mass / link.mass
    if np.allclose(link.heavy_moment, share * link.moment, atol=1e-12):
        lever = scale(share, inertia.moment)
    else:
        carried = scale(link.heavy_mass, pose.position)
        lever = rotate(pose.rotation, link.heavy_moment.tolist(), carried)
    return cross(lever, gravity.tolist()), scale(link.heavy_mass, gravity.tolist())
