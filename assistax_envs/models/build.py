"""Builds a task's `mujoco.MjModel` from its scene, its tool, the human and the robot.

A scene file holds furniture, contact pairs and contact sensors, and attaches `human.xml` and
`panda.xml` under the prefixes `human_` and `robot_`. Here the task's tool is bolted to the robot's
hand. Raise the task's version after a change of MJCF.
"""

import functools
import re
import tempfile
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np

from assistax_base.digest import sha256
from assistax_envs.models.care_scenes import give_mouth, touch_mouth
from assistax_envs.models.gentle_scenes import soften
from assistax_envs.models.looks import dress
from assistax_envs.registered import REGISTERED

_SHARED = ("human.xml", "panda.xml")  # files beside a scene, which it attaches


def build_model(task: str) -> mujoco.MjModel:
    """Compile the scene of `task` with its tool bolted to the robot's hand."""
    return _scene(task).compile()


@functools.cache
def scene_sha256(task: str) -> str | None:
    """Return the sha256 of a task's scene as MJCF, without colours; None for an unknown task.

    MJCF has six digits of a number: a last bit of another processor does not show.
    """
    if task not in REGISTERED:
        return None
    scene = _scene(task)
    scene.compile()
    return sha256(re.sub(r' rgba="[^"]*"', "", scene.to_xml()).encode())


def build_dressed(task: str) -> mujoco.MjModel:
    """Compile the same scene for pictures, with looks in place of the geoms that collide."""
    scene = _scene(task)
    dress(scene, REGISTERED[task].looks, REGISTERED[task].tool)
    return scene.compile()


def _scene(task: str) -> mujoco.MjSpec:
    kind = REGISTERED[task]
    scene, tool = _read(kind.scene.mjcf), _read(kind.tool)
    teeth = kind.scene.teeth
    if kind.seat == "mouth":
        give_mouth(scene, teeth)
    scene.body("robot_hand").add_frame().attach_body(tool.body("tool"), "robot_", "")
    for joint, angle in kind.scene.rest.items():
        scene.joint(f"human_{joint}").springref = angle
    if kind.seat == "mouth":
        touch_mouth(scene, teeth)
    if kind.scene.softened:
        soften(scene, kind.scene.human_share)
        return scene
    for actuator in scene.actuators:
        if actuator.name.startswith("human_"):
            actuator.gear = np.array(actuator.gear) * kind.scene.human_share
    return scene


def _read(mjcf: str) -> mujoco.MjSpec:
    """Parse MJCF: a name in this folder, a file "PACKAGE:NAME.xml", or the text itself."""
    here = resources.files("assistax_envs.models")
    if mjcf.lstrip().startswith("<"):
        text = mjcf
    elif ":" in mjcf:
        package, _, name = mjcf.partition(":")
        text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
    else:
        text = here.joinpath(f"{mjcf}.xml").read_text(encoding="utf-8")
    # MuJoCo reads the models that a scene attaches from files beside it alone.
    with tempfile.TemporaryDirectory() as folder:
        for name in _SHARED:
            Path(folder, name).write_bytes(here.joinpath(name).read_bytes())
        path = Path(folder, "scene.xml")
        path.write_text(text, encoding="utf-8")
        return mujoco.MjSpec.from_file(str(path))
