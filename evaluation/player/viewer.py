"""Play an episode in MuJoCo's own viewer, on a machine with a display."""

import importlib
import os
import sys
import time
import warnings
from typing import Any

import mujoco
import numpy as np

from assistax_envs.drawing.overlay import force_colour
from assistax_envs.drawing.render import ARROW_WIDTH, MARKER_RADIUS, picture_model, pressing, wear
from assistax_envs.registered import TASK_CLASSES
from evaluation.player.episode import Episode, is_felt, scene_of, seconds_of

SPACE, RIGHT, LEFT = 32, 262, 263  # GLFW's keys
DISTANCE = 2.0  # m from the camera to what a mouse turns it about
LENGTH, LENGTH_A_NEWTON = 0.1, 0.012  # m of an arrow, as on the page


def has_display() -> bool:
    """Return whether a window can be opened; a display may be named but not exist."""
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if not named and sys.platform.startswith("linux"):
        return False
    try:
        glfw: Any = importlib.import_module("glfw")
    except ImportError:
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of a display that is not there
        opens = bool(glfw.init())
    if opens:
        glfw.terminate()
    return opens


def view(episode: Episode) -> None:
    """Play an episode repeatedly in a window until it is closed.

    The space key pauses and continues, the left and right keys step.
    """
    model = picture_model(scene_of(episode))
    wear(model, f"human {episode.about['person']}")
    data, clock = mujoco.MjData(model), Clock(len(episode.poses), seconds_of(episode))
    viewer: Any = importlib.import_module("mujoco.viewer")
    panels = {"show_left_ui": False, "show_right_ui": False}
    with viewer.launch_passive(model, data, key_callback=clock.press, **panels) as window:
        mujoco.mj_forward(model, data)
        look(model, data, window.cam)
        while window.is_running():
            step = clock.step(time.monotonic())
            with window.lock():
                pose(model, data, episode, step)
                draw_marks(model, data, window.user_scn, episode, step)
            window.sync()
            time.sleep(clock.seconds)


def look(model: mujoco.MjModel, data: mujoco.MjData, camera: Any) -> None:
    """Set a free camera to the pose of the scene's default camera."""
    away = data.cam_xmat[0].reshape(3, 3)[:, 2]
    camera.azimuth = np.degrees(np.arctan2(-away[1], -away[0]))
    camera.elevation = np.degrees(np.arcsin(-away[2]))
    camera.distance = DISTANCE
    camera.lookat[:] = data.cam_xpos[0] - DISTANCE * away
    model.vis.global_.fovy = model.cam_fovy[0]


class Clock:
    """The time of a playback, which runs in real time, and is paused and stepped by keys."""

    def __init__(self, count: int, seconds: float) -> None:
        self.count, self.seconds = count, seconds
        self._playing, self._at, self._before = True, 0.0, None

    def press(self, key: int) -> None:
        """Handle a pressed key: pause, or step."""
        self._playing = not self._playing if key == SPACE else self._playing
        self._at += {RIGHT: 1.0, LEFT: -1.0}.get(key, 0.0)

    def step(self, now: float) -> int:
        """Return the index of the moment to show at a time in seconds."""
        passed = 0.0 if self._before is None else now - self._before
        self._before = now
        self._at += passed / self.seconds if self._playing else 0.0
        self._at %= self.count
        return int(self._at)


def pose(model: mujoco.MjModel, data: mujoco.MjData, episode: Episode, step: int) -> None:
    """Put the model into the pose of a moment."""
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:] = episode.poses[step], episode.velocities[step]
    mujoco.mj_forward(model, data)


def draw_marks(
    model: mujoco.MjModel, data: mujoco.MjData, scene: Any, episode: Episode, step: int
) -> None:
    """Replace the drawn marks by the targets and an arrow for each force of a moment."""
    scene.ngeom = 0
    colours = TASK_CLASSES[episode.about["task"]].target_colours
    for name, points in episode.targets.items():
        for point in points[step].reshape(-1, 3):
            if np.isfinite(point).all():
                geom = _new(scene, mujoco.mjtGeom.mjGEOM_SPHERE, colours[name])
                geom.pos[:], geom.size[:] = point, MARKER_RADIUS
    newtons = float(episode.force[step])
    for point, way, size in zip(
        *pressing(model, data, newtons, felt=is_felt(episode)), strict=True
    ):
        start = point - way * (LENGTH + LENGTH_A_NEWTON * size)
        geom = _new(scene, mujoco.mjtGeom.mjGEOM_ARROW, force_colour(size))
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, ARROW_WIDTH, start, point)


def _new(scene: Any, kind: mujoco.mjtGeom, colour: tuple[float, ...]) -> Any:
    geom = scene.geoms[scene.ngeom]
    rgba = np.array(colour, np.float32)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
    scene.ngeom += 1
    return geom
