"""Collision: for every place where two geoms may touch, a number below 0 where they do.

Geoms are spheres, capsules and planes. A sphere is a capsule of no length; a capsule is the set of
points within its radius of a segment, `position + x axis` with x in [-1, 1]. Most pairs are apart
most of the time: the straight-line code below computes only whether they touch, and the solver
computes the contacts' points and frames for the few that do (solver.h, `contact_point`).
"""

import dataclasses

import mujoco

from assistax_envs.physics.fused.expressions import (
    Scalar,
    Vector,
    maximum,
    minimum,
    multiply_add,
    multiply_subtract,
    reciprocal,
)
from assistax_envs.physics.fused.kinematics import Pose
from assistax_envs.physics.fused.tree import Tree
from assistax_envs.physics.fused.vectors import (
    add,
    add_scaled,
    dot,
    rotate,
    subtract,
)

PLANE, SPHERE, CAPSULE = (
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_PLANE,
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
    )
)
SMALLEST_DETERMINANT = 1e-12  # m^4; guards the division where segments are nearly parallel


@dataclasses.dataclass(frozen=True)
class Geom:
    """A geom of a contact pair at run time."""

    id: int
    kind: int
    position: Vector  # from `Tree.centre`
    axis: Vector  # half the segment of a capsule, the normal of a plane, zero for a sphere
    half_length: float
    radius: float
    carriers: int  # bits of the dofs that move it


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A place where two geoms may touch; the first one's type is not above the second's.

    `end` is 0 for the nearest points of two segments; a plane meets both ends of a capsule, which
    are candidates of their own with `end` 1 and -1 (a sphere: 1).
    """

    pair: int
    first: Geom
    second: Geom
    end: int


def contact_geoms(model: mujoco.MjModel, tree: Tree, poses: list[Pose]) -> dict[int, Geom]:
    """Return the geoms of the model's contact pairs by id."""
    used = sorted({int(geom) for geom in (*model.pair_geom1, *model.pair_geom2)})
    return {geom: _geom(model, tree, poses, geom) for geom in used}


def _geom(model: mujoco.MjModel, tree: Tree, poses: list[Pose], geom: int) -> Geom:
    kind = int(model.geom_type[geom])
    body = tree.bodies[model.geom_bodyid[geom]]
    place = body.frame(model.geom_pos[geom], model.geom_quat[geom])
    half_length = float(model.geom_size[geom, 1]) if kind == CAPSULE else 0.0
    axis = (place.rotation[:, 2] * {PLANE: 1.0, SPHERE: 0.0, CAPSULE: half_length}[kind]).tolist()
    if place.link is None:
        position = (place.position - tree.centre).tolist()
    else:
        pose = poses[place.link.dof]
        shift = (tree.origins[place.link.tree] - tree.centre).tolist()
        position = add(rotate(pose.rotation, place.position.tolist(), pose.position), shift)
        axis = rotate(pose.rotation, axis)
    radius = 0.0 if kind == PLANE else float(model.geom_size[geom, 0])
    carriers = sum(1 << link.dof for link in place.link.chain) if place.link else 0
    return Geom(geom, kind, position, axis, half_length, radius, carriers)


def candidates(model: mujoco.MjModel, geoms: dict[int, Geom]) -> list[Candidate]:
    """Return where the model's pairs may touch, in MuJoCo's order of contacts."""
    places = []
    for pair in range(model.npair):
        both = geoms[int(model.pair_geom1[pair])], geoms[int(model.pair_geom2[pair])]
        first, second = sorted(both, key=lambda geom: geom.kind)
        ends = (0,) if first.kind != PLANE else (1, -1) if second.kind == CAPSULE else (1,)
        places += [Candidate(pair, first, second, end) for end in ends]
    return places


def gap(candidate: Candidate) -> Scalar:
    """Return a number whose sign is that of the distance between the surfaces."""
    first, second = candidate.first, candidate.second
    if candidate.end:
        return _plane_gap(first, second, candidate.end)
    between = subtract(first.position, second.position)
    if first.half_length:
        between = _between_segments(first, second, between)
    elif second.half_length:
        between = _from_segment(second, between)
    return dot(between, between, -((first.radius + second.radius) ** 2))


def _plane_gap(plane: Geom, other: Geom, end: int) -> Scalar:
    nearest = add_scaled(other.position, float(end), other.axis)
    height = -dot(plane.axis, plane.position)
    return dot(plane.axis, nearest, height - other.radius)


def _from_segment(capsule: Geom, between: Vector) -> Vector:
    """Return the vector from a segment's nearest point, given that from its middle."""
    x = clip(dot(capsule.axis, between) * (1.0 / capsule.half_length**2))
    return [multiply_subtract(x, a, b) for a, b in zip(capsule.axis, between, strict=True)]


def _between_segments(first: Geom, second: Geom, between: Vector) -> Vector:
    """Return the shortest vector from the second to the first segment.

    Nearest points of the lines, clipped to the first segment; then the second segment's best for
    that, and the first's best for this (Ericson, Real-Time Collision Detection, 2005, 5.1.9).
    """
    a, b = first.half_length**2, second.half_length**2
    c = -dot(first.axis, second.axis)
    u, v = -dot(first.axis, between), dot(second.axis, between)
    determinant = maximum(multiply_subtract(c, c, a * b), SMALLEST_DETERMINANT)
    inverse = reciprocal(determinant)
    x = clip(multiply_subtract(c, v, b * u) * inverse)
    y = clip(multiply_subtract(c, x, v) * (1.0 / b))
    x = clip(multiply_subtract(c, y, u) * (1.0 / a))
    between = [multiply_add(x, s, d) for s, d in zip(first.axis, between, strict=True)]
    return [multiply_subtract(y, s, d) for s, d in zip(second.axis, between, strict=True)]


def clip(x: Scalar) -> Scalar:
    """Return x between -1 and 1, the ends of a segment."""
    return maximum(minimum(x, 1.0), -1.0)
