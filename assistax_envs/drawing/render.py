"""Pictures of a simulation, without a display: EGL draws, or OSMesa where EGL does not run.

A picture shows the pose, the task's targets, each touch on the skin and how strong it is, and below
the scene what the step earned and what the colours mean. Any task can be drawn: it names its
targets and their colours itself.
"""

import atexit
import dataclasses
import functools
import weakref
import zlib
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.drawing.gl import functions_from, open_context
from assistax_envs.drawing.overlay import Figures, force_colour, heard_word, panel, panel_height
from assistax_envs.models import build_dressed
from assistax_envs.models.gentle_scenes import touching
from assistax_envs.models.looks import palettes
from assistax_envs.mujoco_warnings import warnings_logged
from assistax_envs.own_settings import own_settings
from assistax_envs.physics import SUBSTEPS
from assistax_envs.preferences import PREFERRED
from assistax_envs.tasks.base import TOUCHABLE, Sensors, Task

if TYPE_CHECKING:
    from collections.abc import Sequence

    from assistax_envs.env import EnvState

CLOSE = "close"  # a camera beside those of the scene: follows the tool and the targets
CLOSE_FROM = "front"  # where it looks from
LARGEST = 4096  # pixels a side

TOOL_BODY = "robot_tool"
MARKER_RADIUS, DOT_RADIUS = 0.02, 0.008  # m, of a target alone and of one among many
HALO_RADIUS, HALO_OPACITY = 0.045, 0.3  # m: wider than the arm, so that a target behind it is seen
ARROW_WIDTH = 0.012  # m
SHORTEST_ARROW, LONGEST_ARROW = 0.06, 0.25  # m
ARROW_LENGTH = 0.01  # m for each N
NEAR = 0.006  # m: a touch that ended within the last 5 ms is drawn where it was
DISC_RADIUS, DISC_GROWTH, DISC_HEIGHT = 0.02, 0.008, 0.006  # m, m for each root of a N, m


class Renderer:
    """Draws simulations of one task at one size.

    Holds an OpenGL context, so use it from one thread.
    """

    def __init__(self, task: Task, width: int = 640, height: int = 480) -> None:
        """Open an OpenGL context.

        Raises:
            ValueError: the size is not one that can be drawn.
            RenderError: neither EGL nor OSMesa works here.
        """
        self._context: Any = None
        self._gl: Any = None
        check_size(width, height)
        platform, self._context = open_context(width, height)
        atexit.register(
            _close, weakref.ref(self)
        )  # before the platform's own exit, which closes the display
        self._context.make_current()
        self.model = picture_model(task.scene)
        self.model.vis.global_.offwidth, self.model.vis.global_.offheight = width, height
        self.model.vis.quality.shadowsize = 2048
        self._task = task
        self._locate = jax.jit(functools.partial(_locate, task, task.sensors))
        self._data = mujoco.MjData(self.model)
        self._scene = mujoco.MjvScene(self.model, maxgeom=2000)
        self._options = mujoco.MjvOption()
        with functions_from(platform):
            self._gl = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)
        self._size = width, height

    @own_settings()
    def frame(
        self,
        state: "EnvState",
        index: int = 0,
        camera: str | None = None,
        caption: tuple[str, ...] = (),
    ) -> np.ndarray:
        """Draw one simulation of a batch.

        Args:
            state: [N] simulations.
            index: which of them.
            camera: a camera of the scene, or "close"; the scene's first one if not given.
            caption: lines to write below. The last names the human: humans of the same name look
                the same.

        Returns:
            uint8 [height, width, 3].
        """
        one = _one(state, index)
        self._pose(one)
        tool, named = self._locate(one.task, jnp.asarray(self._data.sensordata[None], jnp.float32))
        targets = {name: np.asarray(points)[0] for name, points in named.items()}
        self._context.make_current()
        view = self._view(camera, np.asarray(tool), targets)
        wear(self.model, caption[-1] if caption else "")
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self.model, self._data, self._options, None, view, everything, self._scene
        )
        self._mark(targets)
        self._draw_touches(one)
        width, height = self._size
        figures = self._figures(one)
        below = panel_height(width, height, figures, caption)
        viewport = mujoco.MjrRect(0, 0, width, height - below)
        pixels = np.empty((viewport.height, width, 3), np.uint8)
        mujoco.mjr_render(viewport, self._scene, self._gl)
        mujoco.mjr_readPixels(pixels, None, viewport, self._gl)
        return np.concatenate([pixels[::-1], panel(width, below, height, figures, caption)])

    def close(self) -> None:
        """Free the OpenGL context; the renderer cannot draw afterwards."""
        if self._context is not None:
            self._context.make_current()
            if self._gl is not None:
                self._gl.free()
            self._context.free()
            self._context = None

    def __del__(self) -> None:
        self.close()

    def _pose(self, one: "EnvState") -> None:
        mujoco.mj_resetData(self.model, self._data)
        self._data.qpos[:] = one.physics.qpos[0]
        self._data.qvel[:] = one.physics.qvel[0]
        self._data.qacc_warmstart[:] = one.physics.warmstart[0]
        with warnings_logged():
            mujoco.mj_forward(self.model, self._data)

    def _figures(self, one: "EnvState") -> Figures:
        seconds = float(one.step[0]) * SUBSTEPS * self.model.opt.timestep
        reward = round(float(one.reward[0]), 2) + 0.0  # never -0.00
        return Figures(
            title=f"{self._task.name}  {seconds:.2f} s  reward {reward:.2f}",
            terms={name: float(value[0]) for name, value in one.terms.items()},
            force=float(one.measures.force[0]),
            distance=float(one.measures.distance[0]),
            nonfinite=bool(one.nonfinite[0]),
            targets=self._task.target_colours,
            word=heard_word(one),
        )

    def _view(
        self, name: str | None, tool: np.ndarray, targets: dict[str, np.ndarray]
    ) -> mujoco.MjvCamera:
        view = mujoco.MjvCamera()
        names = [self.model.camera(i).name for i in range(self.model.ncam)]
        if name in names or name is None:
            view.type = mujoco.mjtCamera.mjCAMERA_FIXED
            view.fixedcamid = names.index(name) if name else 0
            return view
        if name != CLOSE:
            raise ValueError(f"camera is {name!r}; allowed are {', '.join((*names, CLOSE))}")
        mujoco.mjv_defaultFreeCamera(self.model, view)
        x, y, z = -self._data.cam_xmat[names.index(CLOSE_FROM)].reshape(3, 3)[:, 2]
        view.azimuth, view.elevation = np.degrees([np.arctan2(y, x), np.arcsin(z)])
        points = np.concatenate([tool, *targets.values()])
        view.lookat[:] = points[np.isfinite(points).all(axis=1)].mean(axis=0)
        view.distance = 0.9
        return view

    def _mark(self, targets: dict[str, np.ndarray]) -> None:
        for name, points in targets.items():
            colour = self._task.target_colours[name]
            for point in points[np.isfinite(points).all(axis=1)]:
                self._add_sphere(point, MARKER_RADIUS if len(points) == 1 else DOT_RADIUS, colour)
                if len(points) == 1:
                    self._add_sphere(point, HALO_RADIUS, (*colour[:3], HALO_OPACITY))

    def _add_sphere(self, point: np.ndarray, radius: float, colour: tuple[float, ...]) -> None:
        geom = self._new_geom(mujoco.mjtGeom.mjGEOM_SPHERE, colour)
        geom.pos[:] = point
        geom.size[:] = radius

    def _draw_touches(self, one: "EnvState") -> None:
        """Draw a disc at each touch, and an arrow that ends at the point of the total force."""
        felt = one.measures.contact is not None  # gentle scenes record all touches, not the tool's
        newtons = float(one.measures.force[0])
        points, ways, sizes = pressing(self.model, self._data, newtons, felt=felt)
        if not len(points):
            return
        for point, way, size in zip(points, ways, sizes, strict=True):
            if size:
                self._draw_disc(point, way, size)
        total = sizes @ ways
        length = min(SHORTEST_ARROW + ARROW_LENGTH * newtons, LONGEST_ARROW)
        if np.linalg.norm(total) > 0.0:
            point = np.average(points, axis=0, weights=sizes)
            start = point - total / np.linalg.norm(total) * length
            geom = self._new_geom(mujoco.mjtGeom.mjGEOM_ARROW, force_colour(newtons))
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, ARROW_WIDTH, start, point)

    def _draw_disc(self, point: np.ndarray, way: np.ndarray, newtons: float) -> None:
        geom = self._new_geom(mujoco.mjtGeom.mjGEOM_ELLIPSOID, force_colour(newtons))
        radius = DISC_RADIUS + DISC_GROWTH * newtons**0.5
        geom.pos[:], geom.size[:] = point, (radius, radius, DISC_HEIGHT)
        geom.emission = 0.5  # as bright in the tool's shadow
        quat, matrix = np.zeros(4), np.zeros(9)
        mujoco.mju_quatZ2Vec(quat, way)
        mujoco.mju_quat2Mat(matrix, quat)
        geom.mat[:] = matrix.reshape(3, 3)

    def _new_geom(self, kind: mujoco.mjtGeom, colour: tuple[float, ...]) -> mujoco.MjvGeom:
        geom = self._scene.geoms[self._scene.ngeom]
        mujoco.mjv_initGeom(
            geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(colour, np.float32)
        )
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        geom.emission = 0.4  # seen in shadow too
        self._scene.ngeom += 1
        return geom


def picture_model(scene: str) -> mujoco.MjModel:
    """Return a scene for pictures, in which near geoms make a contact without a force."""
    model = build_dressed(scene)
    model.pair_margin[:] = model.pair_gap[:] = NEAR
    return model


def wear(model: mujoco.MjModel, person: str) -> None:
    """Dress the human in the skin, hair and clothes of a name, the same in all its pictures."""
    worn = palettes()[zlib.crc32(person.encode()) % len(palettes())]
    for material, colour in worn.items():
        model.material(material).rgba[:3] = colour


def pressing(
    model: mujoco.MjModel, data: mujoco.MjData, newtons: float, *, felt: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the robot's touches on the human: points and directions [K, 3], and forces [K] in N.

    The pose gives the places and their shares of the force. The size is the recorded force, since
    a state lacks the motors' torques.

    Args:
        model: Of `picture_model`.
        data: In a pose, after `mj_forward`.
        newtons: The recorded force, N.
        felt: Whether all touches are in it, not the tool's on the arm alone.
    """
    counted = [touch for touch in _touches(model, data) if felt or touch[3]]
    if not counted or newtons <= 0.0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    points, ways, given = (np.array(part) for part in list(zip(*counted, strict=True))[:3])
    if not given.any():  # it has just ended, or the arm has just left: the nearest was it
        given = np.arange(len(given)) == 0
    return points, ways, newtons / given.sum() * given


@own_settings()
def shown(task: Task, model: mujoco.MjModel, states: "Sequence[EnvState]") -> dict[str, np.ndarray]:
    """Return the columns that players draw T states of one simulation from.

    `pose` and `velocity` of all joints [T, nq], `target_NAME` [T, 3 K] in m, NaN where one is not
    to be shown, and `wish_NAME` [T], the preferred values of a human that has preferences.
    """
    joined = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *(one.task for one in states))
    poses, velocities = (
        np.concatenate([np.asarray(getattr(one.physics, name)) for one in states])
        for name in ("qpos", "qvel")
    )
    data, values = mujoco.MjData(model), []
    for pose in poses:
        data.qpos[:] = pose
        with warnings_logged():
            mujoco.mj_forward(model, data)
        values.append(data.sensordata.copy())
    _, targets = _locate(task, task.sensors, joined, jnp.asarray(np.stack(values), jnp.float32))
    columns = {"pose": poses, "velocity": velocities}
    columns |= {f"target_{n}": np.asarray(p).reshape(len(poses), -1) for n, p in targets.items()}
    for name in PREFERRED.get(task.name, ()):
        columns[f"wish_{name}"] = np.asarray(getattr(joined.preference, name))
    return columns


def _touches(
    model: mujoco.MjModel, data: mujoco.MjData
) -> list[tuple[np.ndarray, np.ndarray, float, bool]]:
    """Return contacts of robot and human, the nearest first.

    Of each its point, the direction of the force, its size in N, and whether it is tool on arm.
    """
    arm, tool_body = {f"human_{name}" for name in TOUCHABLE}, model.body(TOOL_BODY).id
    found = []
    for i, contact in sorted(enumerate(data.contact), key=lambda pair: pair[1].dist):
        names = [model.geom(geom).name for geom in contact.geom]
        if parts := touching(*names):
            force = np.zeros(6)
            mujoco.mj_contactForce(model, data, i, force)
            size = float(np.linalg.norm(force[:3]))
            axes = contact.frame.reshape(3, 3)
            way = axes.T @ force[:3] / size if size else axes[0]
            tool = bool(model.geom(parts[0]).bodyid[0] == tool_body)
            sign = 1.0 if names[0] == parts[0] else -1.0
            found.append((contact.pos.copy(), sign * way, size, tool and parts[1] in arm))
    return found


def check_size(width: int, height: int) -> None:
    """Check that a picture of this size can be drawn."""
    for name, pixels in (("width", width), ("height", height)):
        if not 16 <= pixels <= LARGEST:
            raise ValueError(f"{name} is {pixels}; allowed are 16 to {LARGEST} pixels")


def _locate(
    task: Task, sensors: Sensors, task_state: Any, values: jax.Array
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Return the positions of the tool [1, 3] and of the task's targets [1, K, 3]."""
    readings = sensors.read(values)
    return readings.tool_position, task.targets(task_state, readings)


def _close(reference: "weakref.ref[Renderer]") -> None:
    renderer = reference()
    if renderer is not None:
        renderer.close()


def _one(state: "EnvState", index: int) -> "EnvState":
    """Return simulation `index` alone, its leaves [1, ...]."""
    size = state.step.shape[0]
    if not 0 <= index < size:
        raise ValueError(
            f"index is {index}; the batch has {size} simulations, allowed are 0 to {size - 1}"
        )
    state = dataclasses.replace(state, key=jax.random.key_data(state.key))
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[index : index + 1]), state)
