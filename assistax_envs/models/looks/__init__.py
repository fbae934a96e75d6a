"""Looks of pictures in place of the shapes that collide: a Panda, a person, furniture.

The TOML files beside this one name, for bodies of a scene, shapes in the body's frame; all are our
own. They are put onto a scene that is loaded for pictures: physics never has them.
"""

import functools
import tomllib
from importlib import resources
from typing import Any

import mujoco
import numpy as np

HIDDEN = 3  # the group of what collides, which MuJoCo's viewers do not show at first
SIDES, STEPS = 16, 3  # corners of a tube's section, rings from one row to the next
UNPAINTED = [0.5, 0.5, 0.5, 1.0]  # MuJoCo's own default: the material's colour is shown
PRIMITIVES = {
    name: getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")
    for name in ("capsule", "cylinder", "ellipsoid", "box")
}


@functools.cache
def look(name: str) -> dict[str, Any]:
    """Return the content of a file of looks: a name in this folder, or "PACKAGE:NAME.toml"."""
    package, _, file = name.rpartition(":")
    folder = resources.files(package or __name__)
    return tomllib.loads(folder.joinpath(file if package else f"{file}.toml").read_text())


def palettes() -> list[dict[str, list[float]]]:
    """Return the palettes of people: colours of skin, hair and clothes by material."""
    return look("person")["palettes"]


def dress(scene: mujoco.MjSpec, furniture: str, tool: str) -> None:
    """Add looks to a scene in place, and hide the geoms that they stand for.

    Args:
        scene: The scene, tool attached.
        furniture: Name of the looks of its furniture; without one its own geoms are shown.
        tool: Tool in the robot's hand: shapes that are `only` for another one are left out.
    """
    cameras: dict[str, Any] = {}
    head = "mouth" if scene.body("human_jaw") else "head"
    for name in ("room", "panda", "person", *[furniture] * bool(furniture), head):
        parts = look(name)
        for material, (red, green, blue, shine) in parts.get("materials", {}).items():
            scene.add_material(
                name=material, rgba=[red, green, blue, 1.0], specular=shine, shininess=shine
            )
        for body, given in parts.get("bodies", {}).items():
            if name != head and body in look(head).get("replaces", ()):
                continue
            for geom in scene.body(body).geoms:
                geom.group = 1 if geom.name.startswith("look-") else HIDDEN
            for index, shape in enumerate(parts["shapes"][given["shapes"]]):
                if shape.get("only", tool) == tool:
                    _add(scene, body, given, shape, f"look-{name}-{body}-{index}")
        cameras |= parts.get("cameras", {})
    for camera, (position, target, fovy) in cameras.items():
        if scene.camera(camera):
            scene.delete(scene.camera(camera))
        scene.worldbody.add_camera(
            name=camera, pos=position, quat=_towards(position, target), fovy=fovy
        )


def _add(
    scene: mujoco.MjSpec, body: str, given: dict[str, Any], shape: dict[str, Any], name: str
) -> None:
    """Add one shape to a body, without mass and contacts."""
    side = -1.0 if given.get("mirror") else 1.0  # of the left arm, whose shapes are the right one's
    flip = np.array([1.0, side, 1.0])
    geom = scene.body(body).add_geom(
        name=name, mass=0, contype=0, conaffinity=0, group=1, material=shape["material"]
    )
    geom.rgba = UNPAINTED
    geom.set_frame(
        scene.body(body).add_frame(
            pos=given.get("pos", [0, 0, 0]), quat=given.get("quat", [1, 0, 0, 0])
        )
    )
    kind = next(iter(shape))  # a shape's first key says what it is, and where
    where = np.array(shape[kind], float)
    if kind in PRIMITIVES:
        geom.type = PRIMITIVES[kind]
        geom.size = np.resize([*np.ravel(shape["size"]), 0.0, 0.0], 3)
        if where.size == 6:
            geom.fromto = np.concatenate([where[:3] * flip, where[3:] * flip])
        else:
            geom.pos, geom.quat = where * flip, shape.get("quat", [1, 0, 0, 0])
        return
    rows, up = (_circle(*where), [0, 1, 0]) if kind == "ring" else (where, [1, 0, 0])
    points, faces = tube(rows, shape.get("up", up), shape.get("power", 2.0))
    mesh = scene.add_mesh(
        name=name,
        uservert=(points * flip).ravel().tolist(),
        userface=(faces if side > 0 else faces[:, ::-1]).ravel().tolist(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, mesh.name


def tube(rows: np.ndarray, up: list[float], power: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points and triangles of a smooth tube with rounded ends.

    Args:
        rows: centre, and half the width along `up` and across it: [R, 5].
        up: direction of the first width.
        power: of the superellipse: 2 for ellipses, more for rounded boxes.
    """
    rings = _rounded(_smooth(rows))
    along = np.gradient(rings[:, :3], axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    first = np.array(up, float) - (along @ up)[:, None] * along
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    angle = np.arange(SIDES) * 2.0 * np.pi / SIDES
    x, y = (np.sign(f) * np.abs(f) ** (2.0 / power) for f in (np.cos(angle), np.sin(angle)))
    outline = x[:, None] * (rings[:, None, 3:4] * first[:, None])
    outline = outline + y[:, None] * (rings[:, None, 4:5] * second[:, None])
    points = (rings[:, None, :3] + outline).reshape(-1, 3)
    here = np.arange((len(rings) - 1) * SIDES)
    beside = here - here % SIDES + (here + 1) % SIDES
    quads = (here, beside, beside + SIDES, here + SIDES)
    triangles = [np.stack([quads[i] for i in corners], 1) for corners in ((0, 1, 2), (0, 2, 3))]
    return points, np.concatenate(triangles)


def _smooth(rows: np.ndarray) -> np.ndarray:
    """Return rings on a Catmull-Rom curve through the rows."""
    padded = np.concatenate([rows[:1], rows, rows[-1:]])
    before, start, end, after = (padded[i : len(rows) - 1 + i, None] for i in range(4))
    t = (np.arange(STEPS) / STEPS)[None, :, None]
    rings = start + 0.5 * t * (
        end - before
        + t * (2 * before - 5 * start + 4 * end - after + t * (3 * (start - end) + after - before))
    )  # fmt: skip
    return np.concatenate([rings.reshape(-1, rows.shape[1]), rows[-1:]])


def _rounded(rings: np.ndarray, corners: int = 3, roundness: float = 0.35) -> np.ndarray:
    """Close both ends with shrinking rings."""
    ends = []
    for end, before in ((rings[0], rings[1]), (rings[-1], rings[-2])):
        out = (end - before)[:3]
        out = out / np.linalg.norm(out) * roundness * end[3:].min()
        angle = np.arange(1, corners + 1)[:, None] / corners * np.pi / 2
        widths = end[3:] - roundness * end[3:].min() * (1.0 - np.cos(angle))
        cap = np.concatenate([end[:3] + np.sin(angle) * out, widths], axis=1)
        middle = np.array([[*cap[-1, :3] + 1e-3 * out, 1e-4, 1e-4]])
        ends.append(np.concatenate([cap, middle]))
    return np.concatenate([ends[0][::-1], rings, ends[1]])


def _circle(x: float, y: float, z: float, radius: float, width: float) -> np.ndarray:
    """Return rows of a wheel's tyre about the y axis."""
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    still = np.ones_like(angle)
    where = [x + radius * np.cos(angle), y * still, z + radius * np.sin(angle)]
    return np.stack([*where, width * still, width * still], axis=1)


def _towards(position: list[float], target: list[float]) -> np.ndarray:
    """Return the orientation of a camera that looks at a point, upright."""
    back = np.subtract(position, target)
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.stack([right, np.cross(back, right), back], axis=1).ravel())
    return quat
