"""Pictures of a simulation, without a display: EGL draws, or OSMesa where EGL does not run.

A picture shows the pose, the task's targets, the tool's force on the arm, and what the step earned.
Any task can be
drawn: it names its targets and their colours itself.
"""

import atexit
import copy
import dataclasses
import functools
import weakref
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.gl import functions_from, open_context
from assistax_envs.overlay import Figures, write
from assistax_envs.physics import SUBSTEPS
from assistax_envs.tasks.base import TOUCHABLE, Sensors, Task

if TYPE_CHECKING:
    from assistax_envs.env import EnvState

CLOSE = "close"  # a camera beside those of the scene: follows the tool and the targets
LARGEST = 4096  # pixels a side

TOOL_BODY = "robot_tool"
FORCE_COLOUR = (0.05, 0.75, 0.25, 1.0)
MARKER_RADIUS, DOT_RADIUS = 0.018, 0.008  # m, of a target alone and of one among many
HALO_RADIUS, HALO_OPACITY = 0.048, 0.3  # m: wider than the arm, so that a target behind it is seen
ARROW_WIDTH = 0.014  # m
SHORTEST_ARROW, LONGEST_ARROW = 0.06, 0.25  # m
ARROW_LENGTH = 0.01  # m for each N


class Renderer:
    """Draws simulations of one model at one size.

    Holds an OpenGL context, so use it from one thread.
    """

    def __init__(
        self, model: mujoco.MjModel, task: Task, width: int = 640, height: int = 480
    ) -> None:
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
        self.model = copy.copy(model)
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
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._arm = {self.model.geom(f"human_{name}").id for name in TOUCHABLE}
        self._tool = self.model.body(TOOL_BODY).id

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
            caption: lines to write at the lower left.

        Returns:
            uint8 [height, width, 3].
        """
        one = _one(state, index)
        self._pose(one)
        tool, named = self._locate(one.task, jnp.asarray(self._data.sensordata[None], jnp.float32))
        targets = {name: np.asarray(points)[0] for name, points in named.items()}
        self._context.make_current()
        view = self._view(camera, np.asarray(tool), targets)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self.model, self._data, self._options, None, view, everything, self._scene
        )
        self._mark(targets)
        self._draw_force(float(one.measures.force[0]))
        pixels = np.empty((self._viewport.height, self._viewport.width, 3), np.uint8)
        mujoco.mjr_render(self._viewport, self._scene, self._gl)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._gl)
        return write(pixels[::-1], self._figures(one), caption)

    def close(self) -> None:
        """Give the OpenGL context back; the renderer draws no more."""
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
        mujoco.mj_forward(self.model, self._data)

    def _figures(self, one: "EnvState") -> Figures:
        seconds = float(one.step[0]) * SUBSTEPS * self.model.opt.timestep
        return Figures(
            title=f"{self._task.name}  {seconds:.2f} s  reward {float(one.reward[0]):.2f}",
            terms={name: float(value[0]) for name, value in one.terms.items()},
            force=float(one.measures.force[0]),
            distance=float(one.measures.distance[0]),
            nonfinite=bool(one.nonfinite[0]),
        )

    def _view(
        self, name: str | None, tool: np.ndarray, targets: dict[str, np.ndarray]
    ) -> mujoco.MjvCamera:
        view = mujoco.MjvCamera()
        names = [self.model.camera(i).name for i in range(self.model.ncam)]
        if name in names or (name is None and names):
            view.type, view.fixedcamid = (
                mujoco.mjtCamera.mjCAMERA_FIXED,
                names.index(name) if name else 0,
            )
            return view
        if name not in (None, CLOSE):
            raise ValueError(f"camera is {name!r}; allowed are {', '.join((*names, CLOSE))}")
        mujoco.mjv_defaultFreeCamera(self.model, view)
        if name == CLOSE:
            if names:  # from where the scene's own camera looks
                x, y, z = -self._data.cam_xmat[0].reshape(3, 3)[:, 2]
                view.azimuth, view.elevation = (
                    np.degrees(np.arctan2(y, x)),
                    np.degrees(np.arcsin(z)),
                )
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

    def _draw_force(self, newtons: float) -> None:
        """Draw an arrow that ends where the tool presses, as long as the recorded force."""
        forces, points = [np.zeros(3)], [np.zeros(3)]
        for i, contact in enumerate(self._data.contact):
            if sign := self._sign(contact):
                force = np.zeros(6)
                mujoco.mj_contactForce(self.model, self._data, i, force)
                forces.append(sign * contact.frame.reshape(3, 3).T @ force[:3])
                points.append(contact.pos.copy())
        sizes, total = np.linalg.norm(forces, axis=1), np.sum(forces, axis=0)
        if newtons <= 0.0 or np.linalg.norm(total) == 0.0:
            return
        point = np.average(points, axis=0, weights=sizes)
        length = min(SHORTEST_ARROW + ARROW_LENGTH * newtons, LONGEST_ARROW)
        start = point - total / np.linalg.norm(total) * length
        geom = self._new_geom(mujoco.mjtGeom.mjGEOM_ARROW, FORCE_COLOUR)
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, ARROW_WIDTH, start, point)

    def _sign(self, contact: Any) -> int:
        """Return 1 where the tool pushes the arm along the contact's frame, -1 against, else 0."""
        for sign, (tool, arm) in ((1, contact.geom), (-1, contact.geom[::-1])):
            if self.model.geom_bodyid[tool] == self._tool and arm in self._arm:
                return sign
        return 0

    def _new_geom(self, kind: mujoco.mjtGeom, colour: tuple[float, ...]) -> mujoco.MjvGeom:
        geom = self._scene.geoms[self._scene.ngeom]
        mujoco.mjv_initGeom(
            geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(colour, np.float32)
        )
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        geom.emission = 0.4  # seen in shadow too
        self._scene.ngeom += 1
        return geom


def check_size(width: int, height: int) -> None:
    """Check that a picture of this size can be drawn."""
    for name, pixels in (("width", width), ("height", height)):
        if not 16 <= pixels <= LARGEST:
            raise ValueError(f"{name} is {pixels}; allowed are 16 to {LARGEST} pixels")


def _locate(
    task: Task, sensors: Sensors, task_state: Any, values: jax.Array
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Return where the tool [1, 3] and the task's targets [1, K, 3] are."""
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
