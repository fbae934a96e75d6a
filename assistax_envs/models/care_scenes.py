"""Scene of acts of care at the mouth: the wheelchair of scratch, a head that turns, a jaw.

The arms rest, without joints. The human's seat has five torques: the trunk leans, the neck turns
about three axes, and the jaw opens. Lengths in m, angles in rad, in the torso's frame.
"""

import mujoco
import numpy as np

NECK = (-0.01, 0.0, 0.09)  # where the head turns
SKULL, SKULL_SIZE = (-0.003, 0.0, 0.205), 0.08
JAW = (0.0, 0.0, 0.131)  # its hinge, as high as the lower lip: the lip swings down, not back
UPPER_LIP, LOWER_LIP = 0.147, 0.131  # height; with the jaw closed they touch
LIPS_OUT, LIP_SIZE, LIP_HALF = 0.085, 0.008, 0.02
CHIN_HEIGHT, CHIN_OUT, CHIN_SIZE = 0.106, 0.068, 0.015
THROAT, THROAT_SIZE = (0.005, 0.0, 0.131), 0.022  # the bowl touches it some 5 cm behind the lips
# Where the bowl should pass between the lips, in the middle of an opening of 0.3 rad.
MOUTH = (LIPS_OUT, 0.0, 0.127)
# The hands lie in the lap: what the arms' joints would be.
RESTING = {
    "right_upper_arm": {"right_shoulder1": 0.0, "right_shoulder2": -0.6},
    "right_lower_arm": {"right_elbow": -0.36},
    "left_upper_arm": {"left_shoulder1": 0.0, "left_shoulder2": 0.0},
    "left_lower_arm": {"left_elbow": 0.0},
}
# Joint -> its axis, where from and to it turns, stiffness and damping, and the torque of the seat.
# Springs hold the posture: a torque is a place to go to. Dampers make that slow: a policy's noise
# moves the mouth by a millimetre or two, and not by the centimetre that a spoon may be off. Neck:
# half of a healthy one's range.
NECK_JOINTS = {
    "neck_pitch": ((0, 1, 0), (-0.5, 0.6), 12.0, 5.0, 4.0),
    "neck_yaw": ((0, 0, 1), (-0.8, 0.8), 3.0, 1.5, 1.8),
    "neck_roll": ((1, 0, 0), (-0.5, 0.5), 12.0, 5.0, 4.0),
}
OPEN = 0.5  # rad: the lips are 42 mm apart
JAW_SPRING, JAW_SHUT, JAW_DAMPING, JAW_TORQUE = 0.8, -0.25, 0.2, 0.8
LEAN = "abdomen_y"
LEAN_DAMPING = 200.0  # N m s/rad, before the trunk of gentle scenes is three times as damped
LEAN_TORQUE = -370.0  # N m: 6 cm forward at the mouth, against the trunk's springs
ROBOT = (0.66, -0.32, 0.60)  # base: at the right, in front of the knees
STOOD = (0.35, -0.9, 0.6)  # where it stands in the scene of scratch
FACING = 2.618  # rad: towards the mouth
SEAT = (LEAN, "neck_pitch", "neck_yaw", "neck_roll", "jaw")
# By seat, what a disability's range is of.
STIFF_JOINTS = {
    "arm": ("human_right_elbow",),
    "mouth": ("human_neck_pitch", "human_neck_yaw", "human_neck_roll", "human_jaw"),
}
LIPS = ("upper_lip", "lower_lip")
# Rows of teeth by name: the side's ends in the plane of the teeth, x forward and y to the left.
# While teeth are brushed lips and cheeks give way: the brush does not touch them.
ROWS = {
    "right": ((0.054, -0.026), (0.075, -0.018)),
    "front": ((0.078, -0.013), (0.078, 0.013)),
    "left": ((0.075, 0.018), (0.054, 0.026)),
}
TOOTH_SIZE = 0.0045
UPPER_TEETH, LOWER_TEETH = 0.145, 0.133  # height; with the jaw closed they are 3 mm apart
TEETH = tuple(f"{jaw}_{side}_teeth" for jaw in ("upper", "lower") for side in ROWS)
FACE = ("human_head", "human_upper_lip", "human_lower_lip", "human_chin", "human_throat")


def give_mouth(scene: mujoco.MjSpec, teeth: bool) -> None:
    """Give the person of the wheelchair's scene a head that turns and a mouth that opens.

    Changes the scene in place, before a tool is attached.

    Args:
        scene: The scene.
        teeth: Whether the mouth has teeth.
    """
    _rest_arms(scene)
    _give_head(scene)
    if teeth:
        _give_teeth(scene)
    _give_seat(scene)
    base = scene.body("robot_link0").frame
    base.pos, base.alt.euler = ROBOT, [0.0, 0.0, FACING]
    scene.body("stand").pos = np.subtract(ROBOT, STOOD)


def _rest_arms(scene: mujoco.MjSpec) -> None:
    """Delete the arms' joints, and all contacts but the robot's."""
    for body, joints in RESTING.items():
        for name, angle in joints.items():
            joint = scene.joint(f"human_{name}")
            turn = np.zeros(4)
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            mujoco.mju_axisAngle2Quat(turn, axis, angle)
            both = np.zeros(4)
            mujoco.mju_mulQuat(both, scene.body(f"human_{body}").quat, turn)
            scene.body(f"human_{body}").quat = both
            _delete_joint(scene, joint.name)
    for pair in list(scene.pairs):
        if "robot_" not in pair.geomname1 + pair.geomname2:
            scene.delete(pair)


def _delete_joint(scene: mujoco.MjSpec, name: str) -> None:
    users = [s for s in scene.sensors if s.objname == name]
    users += [a for a in scene.actuators if a.target == name]
    for user in users:
        scene.delete(user)
    scene.delete(scene.joint(name))


def _give_head(scene: mujoco.MjSpec) -> None:
    torso = scene.body("human_torso")
    for geom in list(torso.geoms):
        if geom.name == "human_head":
            scene.delete(geom)
    head = torso.add_body(name="human_head", pos=NECK)
    for name, (axis, ends, stiffness, damping, _) in NECK_JOINTS.items():
        head.add_joint(
            name=f"human_{name}", axis=axis, range=ends, limited=True,
            stiffness=[stiffness, 0, 0], damping=[damping, 0, 0], armature=0.01,
        )  # fmt: skip
    at = np.subtract
    _add(head, "head", at(SKULL, NECK), SKULL_SIZE, mass=3.2)
    _add(head, "throat", at(THROAT, NECK), THROAT_SIZE)
    _bar(head, "upper_lip", at((LIPS_OUT, 0.0, UPPER_LIP), NECK), LIP_SIZE)
    head.add_site(name="human_mouth", pos=at(MOUTH, NECK), size=[0.005] * 3, group=4)
    jaw = head.add_body(name="human_jaw", pos=at(JAW, NECK))
    jaw.add_joint(
        name="human_jaw", axis=[0, 1, 0], range=[0.0, OPEN], limited=True, springref=JAW_SHUT,
        stiffness=[JAW_SPRING, 0, 0], damping=[JAW_DAMPING, 0, 0], armature=0.002,
    )  # fmt: skip
    _bar(jaw, "lower_lip", at((LIPS_OUT, 0.0, LOWER_LIP), JAW), LIP_SIZE)
    _bar(jaw, "chin", at((CHIN_OUT, 0.0, CHIN_HEIGHT), JAW), CHIN_SIZE, mass=0.3)
    for kind, field in (
        (mujoco.mjtSensor.mjSENS_FRAMEPOS, "position"),
        (mujoco.mjtSensor.mjSENS_FRAMEQUAT, "orientation"),
    ):
        scene.add_sensor(
            name=f"human_mouth_{field}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="human_mouth",
        )  # fmt: skip


def _give_teeth(scene: mujoco.MjSpec) -> None:
    for body, jaw, height, origin in (
        ("human_head", "upper", UPPER_TEETH, NECK),
        ("human_jaw", "lower", LOWER_TEETH, JAW),
    ):
        for side, ends in ROWS.items():
            places = [np.subtract((*end, height), origin) for end in ends]
            scene.body(body).add_geom(
                name=f"human_{jaw}_{side}_teeth", type=mujoco.mjtGeom.mjGEOM_CAPSULE, mass=0.0,
                size=[TOOTH_SIZE, 0, 0], fromto=np.concatenate(places), contype=0, conaffinity=0,
                group=1, rgba=[0.93, 0.92, 0.86, 1],
            )  # fmt: skip


def _add(body: mujoco.MjsBody, name: str, pos: np.ndarray, size: float, mass: float = 0.0) -> None:
    body.add_geom(
        name=f"human_{name}", type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=pos, size=[size, 0, 0],
        mass=mass, contype=0, conaffinity=0, group=1, rgba=[0.87, 0.69, 0.57, 1],
    )  # fmt: skip


def _bar(body: mujoco.MjsBody, name: str, pos: np.ndarray, size: float, mass: float = 0.0) -> None:
    """Add a capsule across the face."""
    half = np.array([0.0, LIP_HALF, 0.0])
    body.add_geom(
        name=f"human_{name}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[size, 0, 0],
        fromto=[*(pos - half), *(pos + half)], mass=mass, contype=0, conaffinity=0, group=1,
        rgba=[0.75, 0.45, 0.42, 1],
    )  # fmt: skip


def _give_seat(scene: mujoco.MjSpec) -> None:
    """Add actuators of trunk, neck and jaw to the human's seat, and sensors of their joints."""
    scene.joint(f"human_{LEAN}").damping = [LEAN_DAMPING, 0, 0]
    torques = {LEAN: LEAN_TORQUE, "jaw": JAW_TORQUE}
    torques |= {name: row[-1] for name, row in NECK_JOINTS.items()}
    for name in SEAT:
        scene.add_actuator(
            name=f"human_{name}", target=f"human_{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gear=[torques[name], 0, 0, 0, 0, 0], ctrlrange=[-1, 1], ctrllimited=True,
        )  # fmt: skip
        if name == LEAN:
            continue
        for kind, field in (
            (mujoco.mjtSensor.mjSENS_JOINTPOS, "position"),
            (mujoco.mjtSensor.mjSENS_JOINTVEL, "velocity"),
        ):
            scene.add_sensor(
                name=f"human_{name}_{field}", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=f"human_{name}",
            )  # fmt: skip


def touch_mouth(scene: mujoco.MjSpec, teeth: bool) -> None:
    """Let the attached tool touch the face, with sensors of its force on teeth or lips."""
    for sensor in list(scene.sensors):
        if sensor.name.startswith("force-"):
            scene.delete(sensor)
    felt = TEETH if teeth else LIPS
    for part in felt:
        scene.add_sensor(
            name=f"force-{part}", type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM, objname="robot_tool",
            reftype=mujoco.mjtObj.mjOBJ_GEOM, refname=f"human_{part}",
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 2, 1],
        )  # fmt: skip
    like = scene.pairs[0]
    known = {(pair.geomname1, pair.geomname2) for pair in scene.pairs}
    brushed = ("human_head", *(f"human_{part}" for part in TEETH), "human_chin", "human_throat")
    face = brushed if teeth else FACE
    for robot, parts in {
        "robot_tool": face,
        "robot_shaft": face[:-1],
        "robot_hand": ("human_head", "human_chin"),
    }.items():
        for part in parts:
            if (robot, part) not in known:
                scene.add_pair(
                    name=f"{robot.removeprefix('robot_')}-{part.removeprefix('human_')}",
                    geomname1=robot, geomname2=part, condim=like.condim, friction=like.friction,
                )  # fmt: skip
