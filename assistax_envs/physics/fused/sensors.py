"""Sensors: joint angles and velocities, frames of sites, and forces of contacts."""

import mujoco

from assistax_envs.physics.fused.constraints import force_sensors
from assistax_envs.physics.fused.expressions import Block, Scalar, Vector
from assistax_envs.physics.fused.kinematics import Motion, Pose, body_quaternion, point
from assistax_envs.physics.fused.tree import Tree
from assistax_envs.physics.fused.vectors import add, cross, quaternion_product

JOINT_ANGLE = int(mujoco.mjtSensor.mjSENS_JOINTPOS)
JOINT_VELOCITY = int(mujoco.mjtSensor.mjSENS_JOINTVEL)
FRAME_POSITION = int(mujoco.mjtSensor.mjSENS_FRAMEPOS)
FRAME_ORIENTATION = int(mujoco.mjtSensor.mjSENS_FRAMEQUAT)
FRAME_VELOCITY = int(mujoco.mjtSensor.mjSENS_FRAMELINVEL)
CONTACT = int(mujoco.mjtSensor.mjSENS_CONTACT)
# What a contact sensor gives: force in the contact's frame, and that frame's normal and tangent.
FORCE = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
FORCE_AND_FRAME = (
    FORCE
    | 1 << int(mujoco.mjtConDataField.mjCONDATA_NORMAL)
    | 1 << int(mujoco.mjtConDataField.mjCONDATA_TANGENT)
)
SITE_SENSORS = FRAME_POSITION, FRAME_ORIENTATION, FRAME_VELOCITY
SENSORS = JOINT_ANGLE, JOINT_VELOCITY, *SITE_SENSORS, CONTACT


def sensor_values(
    block: Block, model: mujoco.MjModel, tree: Tree, poses: list[Pose], motions: list[Motion]
) -> list[Scalar]:
    """Return the values [nsensordata] of the state; contact forces are `sensed[...]`."""
    values: list[Scalar] = []
    forces = force_sensors(model).tolist()
    for sensor in range(model.nsensor):
        kind, target = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
        if kind == JOINT_ANGLE:
            values.append(block.input(f"q[{target}]"))
        elif kind == JOINT_VELOCITY:
            values.append(block.input(f"qd[{target}]"))
        elif kind == CONTACT:
            first, width = 9 * forces.index(sensor), int(model.sensor_dim[sensor])
            values += [block.input(f"sensed[{first + axis}]") for axis in range(width)]
        else:
            values += _site_value(model, tree, poses, motions, kind, target)
    return values


def _site_value(
    model: mujoco.MjModel,
    tree: Tree,
    poses: list[Pose],
    motions: list[Motion],
    kind: int,
    site: int,
) -> Vector:
    body = int(model.site_bodyid[site])
    place = tree.bodies[body].frame(model.site_pos[site], model.site_quat[site])
    if kind == FRAME_ORIENTATION:
        quaternion = body_quaternion(model, poses, body)
        return quaternion_product(quaternion, model.site_quat[site].tolist())
    if place.link is None:
        return place.position.tolist() if kind == FRAME_POSITION else [0.0, 0.0, 0.0]
    position = point(place, poses, tree)
    if kind == FRAME_POSITION:
        return add(position, tree.origins[place.link.tree].tolist())
    motion = motions[place.link.dof]
    return cross(motion.angular, position, motion.linear)
