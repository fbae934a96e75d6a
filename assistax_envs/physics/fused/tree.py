"""The kinematic tree as constants: one link a joint, with everything welded to it merged.

Bodies without joints add their mass, geoms and sites to the link that carries them, so that the
program computes nothing for them. Each link's frame has its joint's axis as z axis: a joint's
rotation then mixes two columns of a matrix. The frame's x axis is chosen for zeros in the constant
rotation between neighbouring links, which fold away.
"""

import dataclasses

import mujoco
import numpy as np

from assistax_envs.physics.fused.vectors import quaternion_matrix, tidy


@dataclasses.dataclass
class Link:
    """What moves rigidly with one hinge joint. Lengths in m, masses in kg, in the link's frame."""

    dof: int  # number of the joint, of its angle and of its velocity
    parent: "Link | None"  # None: the world
    tree: int  # which of the model's trees it belongs to
    rotation: np.ndarray  # [3, 3] of this frame in the parent's, at the joint's reference angle
    position: np.ndarray  # [3] of this frame's origin, on the joint's axis, in the parent's frame
    reference: float  # rad, the joint's angle in the pose that the model is written in
    mass: float = 0.0
    moment: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))  # mass times centre
    inertia: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))  # at origin
    heavy_mass: float = 0.0  # what gravity acts on: without gravity compensation's share
    heavy_moment: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))

    @property
    def chain(self) -> list["Link"]:
        """This link and all that carry it, the tree's root first."""
        return [*self.parent.chain, self] if self.parent else [self]


@dataclasses.dataclass(frozen=True)
class Place:
    """A frame fixed to a link, or to the world where `link` is None."""

    link: Link | None
    rotation: np.ndarray
    position: np.ndarray

    def frame(self, position: np.ndarray, quaternion: np.ndarray) -> "Place":
        """Return the place of a frame given in this one."""
        return Place(
            self.link,
            tidy(self.rotation @ quaternion_matrix(quaternion)),
            self.position + self.rotation @ position,
        )


@dataclasses.dataclass(frozen=True)
class Tree:
    """All links by dof, and where each body of the model is.

    `origins` [ntree, 3]: a fixed point of the world for each tree, near its links, about which
    its spatial vectors are taken: the nearer, the less is lost to rounding. `centre` is such a
    point for contacts, which may be between trees.
    """

    links: tuple[Link, ...]
    bodies: tuple[Place, ...]
    origins: np.ndarray
    centre: np.ndarray

    @property
    def parents(self) -> list[int]:
        """Return the parent's dof of every dof, -1 for a root."""
        return [link.parent.dof if link.parent else -1 for link in self.links]


def read_tree(model: mujoco.MjModel) -> Tree:
    """Read the links from a model whose joints are all hinges."""
    links: list[Link] = []
    bodies = [Place(None, np.eye(3), np.zeros(3))]
    for body in range(1, model.nbody):
        place = bodies[model.body_parentid[body]]
        place = place.frame(model.body_pos[body], model.body_quat[body])
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            place = _add_link(links, model, joint, place)
        bodies.append(place)
        if place.link is not None:
            _add_mass(place.link, model, body, place)
    origins = _tree_origins(model, links)
    return Tree(tuple(links), tuple(bodies), origins, origins.mean(axis=0))


def _add_link(links: list[Link], model: mujoco.MjModel, joint: int, place: Place) -> Place:
    """Append the link of `joint`, and return the body's place in its frame."""
    anchor = place.position + place.rotation @ model.jnt_pos[joint]
    rotation = frame_about(place.rotation @ model.jnt_axis[joint])
    tree = place.link.tree if place.link else len({link.tree for link in links})
    link = Link(joint, place.link, tree, rotation, anchor, float(model.qpos0[joint]))
    links.append(link)
    return Place(link, tidy(rotation.T @ place.rotation), rotation.T @ (place.position - anchor))


def _add_mass(link: Link, model: mujoco.MjModel, body: int, place: Place) -> None:
    mass, weight = model.body_mass[body], 1.0 - model.body_gravcomp[body]
    centre = place.frame(model.body_ipos[body], model.body_iquat[body])
    about_centre = centre.rotation @ np.diag(model.body_inertia[body]) @ centre.rotation.T
    link.mass += mass
    link.moment = link.moment + mass * centre.position
    link.inertia = link.inertia + about_centre + mass * offset_inertia(centre.position)
    link.heavy_mass += weight * mass
    link.heavy_moment = link.heavy_moment + weight * mass * centre.position


def offset_inertia(c: np.ndarray) -> np.ndarray:
    """Return the inertia of a unit point mass at `c` about the origin (Huygens and Steiner)."""
    return c @ c * np.eye(3) - np.outer(c, c)


def frame_about(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is `axis`, with as many zeros as there can be."""
    axis = tidy(axis / np.linalg.norm(axis))
    unit = np.eye(3)
    smallest = unit[np.argmin(np.abs(axis))]
    if np.count_nonzero(axis) == 1:
        x = np.roll(np.abs(axis), 1)
    elif np.count_nonzero(axis) == 2:
        x = smallest
    else:
        x = np.cross(smallest, axis) / np.linalg.norm(np.cross(smallest, axis))
    return tidy(np.stack([x, np.cross(axis, x), axis], axis=1))


def _tree_origins(model: mujoco.MjModel, links: list[Link]) -> np.ndarray:
    """Return the mean of each tree's joint anchors in the reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    trees = np.array([link.tree for link in links])
    return np.array([data.xanchor[trees == tree].mean(axis=0) for tree in range(max(trees) + 1)])
