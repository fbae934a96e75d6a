"""Data of a scene for the player's page: bodies, joints, shapes and colours of the films' model."""

from typing import Any

import mujoco
import numpy as np

from assistax_envs.drawing.render import picture_model, wear
from assistax_envs.models.looks import HIDDEN

KINDS = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}
GRAIN = 1e-4  # m: points of meshes are whole numbers of it


def scene_content(scene: str, person: str) -> dict[str, Any]:
    """Return the page's data of a scene, JSON-ready: lengths in m, angles in rad.

    Args:
        scene: The task of the scene.
        person: The name of the human's appearance, as in films.
    """
    model = picture_model(scene)
    wear(model, person)
    shown = [i for i in range(model.ngeom) if model.geom_group[i] < HIDDEN]
    drawn = [i for i in shown if int(model.geom_type[i]) in KINDS]
    return {
        "bodies": [_body(model, i) for i in range(1, model.nbody)],
        "geoms": [_geom(model, i) for i in drawn],
        "meshes": [_mesh(model, i) for i in range(model.nmesh)],
        "grain": GRAIN,
        "camera": _camera(model),
    }


def _body(model: mujoco.MjModel, index: int) -> dict[str, Any]:
    first, count = model.body_jntadr[index], model.body_jntnum[index]
    joints = range(first, first + count)
    if any(model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE for joint in joints):
        raise ValueError(f"body {model.body(index).name} has a joint that is no hinge")
    return {
        "name": model.body(index).name,
        "parent": int(model.body_parentid[index]) - 1,  # -1 is the world
        "pos": _rounded(model.body_pos[index]),
        "quat": _rounded(model.body_quat[index], 7),
        "joints": [
            {
                "angle": int(model.jnt_qposadr[joint]),  # index into a pose
                "rest": float(model.qpos0[model.jnt_qposadr[joint]]),
                "pos": _rounded(model.jnt_pos[joint]),
                "axis": _rounded(model.jnt_axis[joint], 7),
            }
            for joint in joints
        ],
    }


def _geom(model: mujoco.MjModel, index: int) -> dict[str, Any]:
    material = int(model.geom_matid[index])
    own = model.geom_rgba[index]
    painted = material >= 0 and np.allclose(own, [0.5, 0.5, 0.5, 1.0])
    return {
        "body": int(model.geom_bodyid[index]) - 1,
        "kind": KINDS[int(model.geom_type[index])],
        "size": _rounded(model.geom_size[index]),
        "pos": _rounded(model.geom_pos[index]),
        "quat": _rounded(model.geom_quat[index], 7),
        "colour": _rounded(model.mat_rgba[material] if painted else own, 3),
        "mesh": int(model.geom_dataid[index]),
    }


def _mesh(model: mujoco.MjModel, index: int) -> dict[str, Any]:
    first, count = model.mesh_vertadr[index], model.mesh_vertnum[index]
    face, faces = model.mesh_faceadr[index], model.mesh_facenum[index]
    points = np.round(model.mesh_vert[first : first + count] / GRAIN).astype(int)
    return {
        "points": points.ravel().tolist(),
        "faces": model.mesh_face[face : face + faces].ravel().tolist(),
    }


def _camera(model: mujoco.MjModel) -> dict[str, Any]:
    """Return the position, the direction and the opening of the films' first camera."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    towards = -data.cam_xmat[0].reshape(3, 3)[:, 2]
    place = {"pos": _rounded(data.cam_xpos[0]), "towards": _rounded(towards)}
    return place | {"fovy": float(model.cam_fovy[0])}


def _rounded(values: np.ndarray, digits: int = 6) -> list[float]:
    return np.round(np.asarray(values, float), digits).tolist()
