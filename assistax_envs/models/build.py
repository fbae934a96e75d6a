"""Builds a task's `mujoco.MjModel` from the MJCF files beside this one.

A scene file holds furniture, contact pairs and contact sensors, and attaches `human.xml` and `panda.xml` under the
prefixes `human_` and `robot_`; here the task's tool is bolted to the robot's hand. Edit the MJCF files to change a
scene; bump the task's version in `assistax_envs.versions` when you do.
"""

from importlib import resources

import mujoco

TOOLS: dict[str, str] = {"scratch": "stick"}  # tool file of each task


def build_model(task: str) -> mujoco.MjModel:
    """Compile the scene of `task` with its tool bolted to the robot's hand."""
    with resources.as_file(resources.files("assistax_envs.models")) as folder:
        scene = mujoco.MjSpec.from_file(str(folder / f"{task}.xml"))
        tool = mujoco.MjSpec.from_file(str(folder / f"{TOOLS[task]}.xml"))
        scene.body("robot_hand").add_frame().attach_body(tool.body("tool"), "robot_", "")
        return scene.compile()
