"""Forward kinematics: where every link is, and how it moves.

All is in world axes, about the fixed origin of the link's tree. A spatial vector is a pair of
vectors (Featherstone, Rigid Body Dynamics Algorithms, 2008): a motion is (angular velocity,
velocity of the point of the body that is at the origin). Because all links of a tree share one
frame, motions and forces of different links are added without being transformed.
"""

import dataclasses

import mujoco

from assistax_envs.physics.fused.expressions import (
    Block,
    Matrix,
    Value,
    Vector,
    multiply_add,
    multiply_subtract,
)
from assistax_envs.physics.fused.tree import Link, Place, Tree
from assistax_envs.physics.fused.vectors import (
    ZERO,
    add,
    cross,
    product,
    quaternion_product,
    rotate,
    scale,
)


@dataclasses.dataclass(frozen=True)
class Pose:
    """A link's frame, and the motion that its joint allows."""

    rotation: Matrix  # of the frame, in world axes
    position: Vector  # of the frame's origin, from the tree's origin
    axis: Vector  # of the joint: the angular part of its unit motion
    moment: Vector  # the linear part: position x axis
    half: tuple[Value, Value]  # sine and cosine of half the joint's angle


@dataclasses.dataclass(frozen=True)
class Motion:
    """A link's velocity, and its acceleration while no joint accelerates."""

    angular: Vector
    linear: Vector
    angular_bias: Vector = ZERO
    linear_bias: Vector = ZERO


STILL = Motion(ZERO, ZERO)


def link_poses(block: Block, tree: Tree) -> list[Pose]:
    """Return the pose of every link at the joint angles `q`."""
    poses: list[Pose] = []
    for link in tree.links:
        poses.append(_pose(block, link, tree, poses))
    return poses


def _pose(block: Block, link: Link, tree: Tree, poses: list[Pose]) -> Pose:
    fixed = link.rotation.tolist()
    if link.parent is None:
        rotation, position = fixed, (link.position - tree.origins[link.tree]).tolist()
    else:
        parent = poses[link.parent.dof]
        rotation = product(parent.rotation, fixed)
        position = rotate(parent.rotation, link.position.tolist(), parent.position)
    half = block.half_sincos(block.input(f"q[{link.dof}]") - link.reference)
    axis = [row[2] for row in rotation]
    return Pose(_turn(rotation, half), position, axis, cross(position, axis), half)


def _turn(rotation: Matrix, half: tuple[Value, Value]) -> Matrix:
    """Return the rotation followed by one about its own z axis."""
    twice = half[0] + half[0]
    sine, cosine = twice * half[1], multiply_subtract(twice, half[0], 1.0)
    return [
        [multiply_add(x, cosine, y * sine), multiply_add(y, cosine, -(x * sine)), z]
        for x, y, z in rotation
    ]


def link_motions(block: Block, tree: Tree, poses: list[Pose]) -> list[Motion]:
    """Return the motion of every link at the joint velocities `qd`."""
    motions: list[Motion] = []
    for link, pose in zip(tree.links, poses, strict=True):
        parent = motions[link.parent.dof] if link.parent else STILL
        rate = block.input(f"qd[{link.dof}]")
        motions.append(_motion(parent, scale(rate, pose.axis), scale(rate, pose.moment)))
    return motions


def _motion(parent: Motion, angular: Vector, linear: Vector) -> Motion:
    """Return the motion of a link whose joint adds (angular, linear) to its parent's.

    The joint's axis moves with the parent: its velocity times the joint's is the bias (the spatial
    cross product of the two motions).
    """
    if parent is STILL:
        return Motion(angular, linear)
    return Motion(
        add(parent.angular, angular),
        add(parent.linear, linear),
        cross(parent.angular, angular, parent.angular_bias),
        cross(parent.linear, angular, cross(parent.angular, linear, parent.linear_bias)),
    )


def point(place: Place, poses: list[Pose], tree: Tree) -> Vector:
    """Return the origin of a frame on a link, from the origin of the link's tree."""
    assert place.link is not None
    pose = poses[place.link.dof]
    return rotate(pose.rotation, place.position.tolist(), pose.position)


def body_quaternion(model: mujoco.MjModel, poses: list[Pose], body: int) -> Vector:
    """Return a body's orientation as MuJoCo's kinematics compute it, with the same sign."""
    if body == 0:
        return [1.0, 0.0, 0.0, 0.0]
    parent = body_quaternion(model, poses, int(model.body_parentid[body]))
    quaternion = quaternion_product(parent, model.body_quat[body].tolist())
    first = model.body_jntadr[body]
    for joint in range(first, first + model.body_jntnum[body]):
        sine, cosine = poses[joint].half
        turn = [cosine, *scale(sine, model.jnt_axis[joint].tolist())]
        quaternion = quaternion_product(quaternion, turn)
    return quaternion
