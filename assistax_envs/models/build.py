"""Builds a task's `mujoco.MjModel` from the MJCF files beside this one.

A scene file holds furniture, contact pairs and contact sensors, and attaches `human.xml` and
`panda.xml` under the prefixes `human_` and `robot_`; here the task's tool is bolted to the robot's
hand. Edit the MJCF files to change a scene; bump the task's version in `assistax_envs.registered`
when you do.
"""

import functools
import re
from importlib import resources

import mujoco
import numpy as np

from assistax_base.digest import sha256
from assistax_envs.models.care_scenes import give_mouth, touch_mouth
from assistax_envs.models.gentle_scenes import SCENES, soften
from assistax_envs.models.looks import dress
from assistax_envs.registered import REGISTERED

LYING_LEFT_ARM = {
    "left_shoulder2": 0.84,
    "left_elbow": -1.571,
}  # rad: rests beside the body, as its springs hold it
REST: dict[str, dict[str, float]] = {"bed_bath": LYING_LEFT_ARM, "arm_assist": LYING_LEFT_ARM}
WEAKNESS: dict[str, float] = {
    "arm_assist": 0.07
}  # share of the right arm's torque limits: too weak to lift itself


def build_model(task: str) -> mujoco.MjModel:
    """Compile the scene of `task` with its tool bolted to the robot's hand."""
    return _scene(task).compile()


@functools.cache
def scene_sha256(task: str) -> str | None:
    """Return the sha256 of a task's scene as MJCF, without colours; None if it has no scene here.

    MJCF has six digits of a number: a last bit of another processor does not show.
    """
    if task not in REGISTERED:
        return None
    scene = _scene(task)
    scene.compile()
    return sha256(re.sub(r' rgba="[^"]*"', "", scene.to_xml()).encode())


def build_dressed(task: str) -> mujoco.MjModel:
    """Compile the same scene for pictures: what collides is hidden behind what it stands for."""
    scene = _scene(task)
    dress(scene, SCENES.get(task, task), REGISTERED[task].tool)
    return scene.compile()


def _scene(task: str) -> mujoco.MjSpec:
    base = SCENES.get(task, task)
    with resources.as_file(resources.files("assistax_envs.models")) as folder:
        scene = mujoco.MjSpec.from_file(str(folder / f"{base}.xml"))
        tool = mujoco.MjSpec.from_file(str(folder / f"{REGISTERED[task].tool}.xml"))
        at_mouth, teeth = REGISTERED[task].seat == "mouth", REGISTERED[task].tool == "brush"
        if at_mouth:
            give_mouth(scene, teeth)
        scene.body("robot_hand").add_frame().attach_body(tool.body("tool"), "robot_", "")
        for joint, angle in REST.get(base, {}).items():
            scene.joint(f"human_{joint}").springref = angle
        if at_mouth:
            touch_mouth(scene, teeth)
        if task in SCENES:
            soften(scene, task)
            return scene
        for actuator in scene.actuators:
            if actuator.name.startswith("human_"):
                actuator.gear = np.array(actuator.gear) * WEAKNESS.get(task, 1.0)
        return scene
