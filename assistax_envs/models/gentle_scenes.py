"""Softening of a scene: the skin gives way, the robot runs in reduced mode, all touches are felt.

The changes are made on the parsed MJCF, so that a body or a piece of furniture is described once.
"""

import mujoco
import numpy as np

# Of the robot's torque limits: what a collaborative robot is run at beside a person.
ROBOT_SHARE = 0.3
TRUNK = 3.0  # times as stiff and damped as in the paper's scenes: 500 N bend those by 14 degrees
# Of Newton's method, at most. At the paper's 4 MuJoCo's C engine and MJX have not always converged,
# and show contact forces that are not there: 2.2% of gentle lift's episodes above 65 N, not 0.5%.
ITERATIONS = 8
SKIN = 0.06  # s, time constant of robot on human: flesh gives way by millimetres at a few newtons
ARM = ("human_right_upper_arm", "human_right_lower_arm", "human_right_hand")
BODY = ("human_head", "human_torso", *ARM)
LINKS = {  # name of a capsule -> the robot's body that has it, its place there, what it may touch
    "robot_elbow": ("robot_link4", 0, ARM),
    "robot_upper_forearm": ("robot_link5", 0, ARM),
    "robot_forearm": ("robot_link5", 1, BODY),
    "robot_wrist_joint": ("robot_link6", 0, ARM),
    "robot_wrist": ("robot_link6", 1, BODY),
    "robot_flange": ("robot_link7", 0, ARM),
    "robot_hand": ("robot_hand", 0, BODY),
    "robot_shaft": ("robot_tool", 0, ARM),
}
LEGS = ("right_thigh", "left_thigh")  # parts of the human that belong to the furniture's files


def soften(scene: mujoco.MjSpec, human_share: float) -> None:
    """Soften a scene in place, after its tool is attached.

    Args:
        scene: The scene.
        human_share: Share of the human's torque limits that is left.
    """
    scene.option.iterations = ITERATIONS
    for actuator in scene.actuators:
        human = actuator.name.startswith("human_")
        actuator.gear = np.array(actuator.gear) * (human_share if human else ROBOT_SHARE)
    for joint in scene.joints:
        if "abdomen" in joint.name:
            joint.stiffness = np.array(joint.stiffness) * TRUNK
            joint.damping = np.array(joint.damping) * TRUNK
    _give_contacts(scene)
    for pair in scene.pairs:
        touch = touching(pair.geomname1, pair.geomname2)
        if touch:
            pair.solref = np.array([SKIN, 1.0])
            _feel(scene, *touch)


def _give_contacts(scene: mujoco.MjSpec) -> None:
    """Add contacts of the human with all of the robot from its elbow on.

    Without them the robot takes short ways through the human.
    """
    known = {frozenset((pair.geomname1, pair.geomname2)) for pair in scene.pairs}
    like = scene.pairs[0]
    for name, (body, place, parts) in LINKS.items():
        geom = scene.body(body).geoms[place]
        geom.name = geom.name or name  # the stick is all shaft, and keeps its name
        for part in parts:
            if frozenset((geom.name, part)) not in known:
                scene.add_pair(
                    name=f"{geom.name.removeprefix('robot_')}-{part.removeprefix('human_')}",
                    geomname1=geom.name,
                    geomname2=part,
                    condim=like.condim,
                    friction=like.friction,
                )


def touching(geom1: str, geom2: str) -> tuple[str, str] | None:
    """Return the robot's and the human's geom of a contact pair; None if it lacks either."""
    robot = [name for name in (geom1, geom2) if name.startswith("robot_")]
    human = [name for name in (geom1, geom2) if name.startswith("human_") or name in LEGS]
    return (robot[0], human[0]) if robot and human else None


def _feel(scene: mujoco.MjSpec, robot: str, human: str) -> None:
    """Add a sensor of the strongest contact of two geoms: force, normal, tangent, 9 numbers."""
    data = mujoco.mjtConDataField
    fields = (data.mjCONDATA_FORCE, data.mjCONDATA_NORMAL, data.mjCONDATA_TANGENT)
    what = sum(1 << int(field) for field in fields)
    for sensor in scene.sensors:
        if (sensor.objname, sensor.refname) == (robot, human):  # the tool on the arm is sensed
            sensor.intprm = [what, *sensor.intprm[1:]]
            return
    scene.add_sensor(
        name=f"touch-{robot}-{human}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=robot,
        reftype=mujoco.mjtObj.mjOBJ_GEOM,
        refname=human,
        intprm=[what, 2, 1],  # what, reduced to the strongest, how many
    )
