"""Pictures: what must be seen is seen, the same state gives the same bytes, and a machine that
cannot draw says so.
"""

import ctypes.util
import dataclasses
import importlib
import itertools
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from assistax_envs import EnvState
from assistax_envs.drawing import gl
from assistax_envs.drawing.overlay import COSTS, EARNS, LEVELS, Figures, panel
from assistax_envs.drawing.render import Renderer
from assistax_envs.models import build, build_dressed, build_model
from assistax_envs.registered import TASK_CLASSES
from tests.envs.conftest import each_of, environment, start
from tests.system import needs

ROOT = Path(__file__).parents[2]
TASK = "scratch"
TARGETS = {"itch": (0.95, 0.05, 0.55, 1.0)}
SIZE = {"width": 320, "height": 240}
SCENE = 150  # lines of pixels that are scene at this size; words stand below


@pytest.fixture(scope="module")
def two() -> EnvState:
    return start(TASK, "native", ["d1", "d1"], seed=0)


def coloured(frame: np.ndarray, kind: str) -> int:
    """Count the pixels of a marker in the scene: magenta targets, green or amber forces."""
    red, green, blue = np.moveaxis(frame[:SCENE].astype(int), -1, 0)
    if kind == "target":
        return int(((red - green > 90) & (blue - green > 40)).sum())
    gentle = (green - red > 80) & (green - blue > 20)
    return int((gentle | ((red - blue > 150) & (green - blue > 90))).sum())


@each_of(TASK_CLASSES)
@pytest.mark.parametrize("camera", [None, "close"])
def test_a_picture_is_not_blank(task: str, camera: str | None):
    frame = environment(task, "native").render(start(task, "native", ["d1"]), camera=camera, **SIZE)
    assert frame.shape == (240, 320, 3) and frame.dtype == np.uint8
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 200
    assert frame.std() > 20.0


def test_same_state_gives_same_picture(two: EnvState):
    env = environment(TASK, "native")
    first, other = env.render(two, 0, **SIZE), env.render(two, 1, **SIZE)
    np.testing.assert_array_equal(env.render(two, 0, **SIZE), first)
    # A renderer is made from the task, which an environment keeps to itself.
    np.testing.assert_array_equal(Renderer(env._task, **SIZE).frame(two, 0), first)
    assert (other != first).any()


def test_the_target_is_seen(two: EnvState, monkeypatch: pytest.MonkeyPatch):
    env = environment(TASK, "native")
    assert coloured(env.render(two, **SIZE), "target") > 10
    monkeypatch.setattr(
        env._task, "targets", lambda state, readings: {"itch": jnp.full((1, 1, 3), jnp.nan)}
    )
    assert coloured(Renderer(env._task, **SIZE).frame(two), "target") == 0


def test_touch_is_a_growing_disc_and_arrow(two: EnvState, monkeypatch: pytest.MonkeyPatch):
    env = environment(TASK, "native")
    touching = pressed(env, two)

    def arrow(newtons: float) -> int:
        measures = dataclasses.replace(touching.measures, force=jnp.full(2, newtons))
        return coloured(
            env.render(dataclasses.replace(touching, measures=measures), camera="close", **SIZE),
            "force",
        )

    assert arrow(0.0) == 0
    assert 0 < arrow(2.0) < arrow(15.0)


def pressed(env, state: EnvState) -> EnvState:
    """Return a state whose upper arm lies against the stick: found by turning the shoulder, without
    the physics.
    """
    data = mujoco.MjData(env.model)
    tool, arm = (env.model.geom(name).id for name in ("robot_tool", "human_right_lower_arm"))
    base = np.asarray(state.physics.qpos)
    joints = [env.model.joint(f"robot_joint{i}").qposadr[0] for i in range(1, 7)]
    rng = np.random.default_rng(0)
    for _ in range(20_000):
        qpos = base[0].copy()
        qpos[joints] += rng.uniform(-0.8, 0.8, len(joints))
        data.qpos[:] = qpos
        mujoco.mj_kinematics(env.model, data)
        if -0.01 < mujoco.mj_geomDistance(env.model, data, tool, arm, 0.1, None) < -0.001:
            physics = dataclasses.replace(
                state.physics, qpos=jnp.asarray(np.stack([qpos, qpos]), jnp.float32)
            )
            return dataclasses.replace(state, physics=physics)
    raise AssertionError("no pose with contact was found")


def words(**changes) -> np.ndarray:
    figures = Figures("scratch", {"reach": 0.5, "cost": 0.0}, 2.5, 0.1, False, TARGETS)
    return panel(320, 90, 240, dataclasses.replace(figures, **changes), ("robot zero",))


def test_strip_follows_the_figures():
    plain = words()
    assert plain.shape == (90, 320, 3)

    def painted(pixels: np.ndarray, colour: tuple[int, ...]) -> int:
        return int((pixels == np.array(colour)).all(axis=-1).sum())

    longer, costly = words(terms={"reach": 1.0, "cost": 0.0}), words(terms={"reach": 0, "cost": -1})
    assert painted(longer, EARNS) > painted(plain, EARNS) > painted(costly, EARNS)
    assert painted(costly, COSTS) > painted(plain, COSTS)
    for newtons, (_, colour) in zip((2.0, 20.0, 80.0), LEVELS, strict=True):
        other = 2.0 if newtons > 32.5 else 80.0
        assert painted(words(force=newtons), colour) > painted(words(force=other), colour)
    assert painted(plain, (242, 13, 140)) > 10  # the target's colour is explained
    assert (words(nonfinite=True) != plain).any()


def test_words_never_cover_the_scene(two: EnvState):
    """The scene is drawn above the words, which change none of its pixels."""
    env = environment(TASK, "native")
    rich = dataclasses.replace(two, reward=jnp.full(2, 123.0))
    first, other = env.render(two, **SIZE), env.render(rich, **SIZE)
    assert (first[:SCENE] == other[:SCENE]).all() and (first[SCENE:] != other[SCENE:]).any()
    assert env.render(two, width=64, height=48).shape == (48, 64, 3)  # no room for words


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_looks_change_no_physics(task: str):
    """What is drawn has the physics of what is simulated: the shapes on top have no mass, touch
    nothing, and are not in the model of the tasks at all.
    """
    plain, dressed = build_model(task), build_dressed(task)
    assert not any(plain.geom(i).name.startswith("look-") for i in range(plain.ngeom))
    assert (plain.nmesh, dressed.nmesh > 30) == (0, True)
    for field in ("nq", "nv", "nu", "nbody", "nsensordata", "npair"):
        assert getattr(plain, field) == getattr(dressed, field), field
    for field in ("body_mass", "body_inertia", "body_pos", "qpos0", "jnt_range", "pair_solref"):
        np.testing.assert_array_equal(getattr(plain, field), getattr(dressed, field), field)
    pose = TASK_CLASSES[task](plain).pose.angle
    after = []
    for model in (plain, dressed):
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = pose, 0.3
        for _ in range(100):
            mujoco.mj_step(model, data)
        after.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
    np.testing.assert_array_equal(*after)


def test_planted_heavy_or_touching_shape_is_noticed(monkeypatch: pytest.MonkeyPatch):
    # The scene before it is compiled, to which a shape can be added.
    plain, scene = build_model(TASK), build._scene(TASK)
    scene.body("human_right_lower_arm").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05] * 3)
    monkeypatch.setattr(build, "_scene", lambda task: scene)
    with pytest.raises(AssertionError):
        np.testing.assert_array_equal(build_dressed(TASK).body_mass, plain.body_mass)


def test_humans_of_one_name_look_alike():
    env = environment(TASK, "native")
    healthy, frail = (start(TASK, "native", [setting], seed=0) for setting in ("d1", "d9"))

    def person(state: EnvState, name: str) -> np.ndarray:
        return env.render(state, caption=(name,), **SIZE)[:SCENE]

    np.testing.assert_array_equal(person(healthy, "a"), person(frail, "a"))
    assert len({person(healthy, name).tobytes() for name in "abcdefghijkl"}) > 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"camera": "ceiling"}, "camera is 'ceiling'; allowed are .*close"),
        ({"index": 2}, "index is 2; the batch has 2 simulations, allowed are 0 to 1"),
        ({"width": 5}, "width is 5; allowed are 16 to 4096 pixels"),
        ({"height": 10_000}, "height is 10000; allowed"),
    ],
)
def test_wrong_arguments_say_what_is_allowed(two: EnvState, arguments: dict, message: str):
    with pytest.raises(ValueError, match=message):
        environment(TASK, "native").render(two, **{**SIZE, **arguments})


def test_machine_without_opengl_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    class Broken:
        def GLContext(self, width: int, height: int):
            raise RuntimeError("no such\nlibrary")

    monkeypatch.setattr(importlib, "import_module", lambda name: Broken())
    with pytest.raises(
        gl.RenderError,
        match=r"\(egl: no such library; osmesa: .*apt-get install libegl1 .*libosmesa6",
    ):
        gl.open_context(64, 64)
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    with pytest.raises(gl.RenderError, match=r"\(osmesa: no such library\)"):
        gl.open_context(64, 64)


@pytest.mark.slow
@needs("libosmesa6", ctypes.util.find_library("OSMesa"))
def test_osmesa_draws_the_same_as_egl(tmp_path: Path):
    """In a process of its own, because PyOpenGL takes one platform a process; EGL fails there for
    want of a device.
    """
    script = (
        "import sys, jax, numpy as np, assistax_envs\n"
        f"env = assistax_envs.make({TASK!r}, 'native')\n"
        "keys = jax.random.split(jax.random.key(0), 1)\n"
        "state = jax.jit(env.reset)(keys, assistax_envs.disability_params(['d1']))\n"
        f"np.save(sys.argv[1], env.render(state, **{SIZE!r}))\n"
        "print(sys.modules['OpenGL.platform'].PLATFORM.__class__.__name__)\n"
    )
    variables = {
        name: value
        for name, value in os.environ.items()
        if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")
    }
    result = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "frame.npy")],
        cwd=ROOT, capture_output=True, text=True, env=variables | {"MUJOCO_EGL_DEVICE_ID": "99"},
    )  # fmt: skip
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.strip() == "OSMesaPlatform"
    here = environment(TASK, "native").render(start(TASK, "native", ["d1"]), **SIZE)
    assert np.abs(here.astype(int) - np.load(tmp_path / "frame.npy")).max() <= 2


def test_closed_renderer_frees_its_context(two: EnvState):
    env = environment(TASK, "native")
    renderer = Renderer(env._task, 64, 48)
    renderer.close()
    renderer.close()
    del renderer
    assert env.render(two, **SIZE).std() > 20.0


@pytest.mark.parametrize("adapter", ["gymnasium", "pettingzoo"])
def test_adapters_draw(adapter: str):
    module = importlib.import_module(f"assistax_envs.adapters.{adapter}")
    kind = module.AssistaxEnv if adapter == "gymnasium" else module.AssistaxParallelEnv
    env = kind(TASK, render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    assert frame.shape == (480, 640, 3) and frame.dtype == np.uint8
    assert kind(TASK).render() is None
    env.close()
    assert jax.default_backend() == "cpu"


@pytest.mark.parametrize("scene", ["scratch", "bed_bath", "arm_assist"])
def test_default_camera_sees_the_arm(scene: str):
    model = build_dressed(scene)
    data = mujoco.MjData(model)
    arm = [model.joint(f"human_right_{name}").id for name in ("shoulder1", "shoulder2", "elbow")]
    body = model.body("human_right_lower_arm").id
    geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == body]
    for places in itertools.product(*(np.linspace(*model.jnt_range[joint], 5) for joint in arm)):
        data.qpos[:] = model.qpos0
        data.qpos[model.jnt_qposadr[arm]] = places
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        seen = (data.geom_xpos[geoms] - data.cam_xpos[0]) @ data.cam_xmat[0].reshape(3, 3)
        edges = np.tan(np.radians(model.cam_fovy[0]) / 2) * np.array([4 / 3, 1])
        assert (np.abs(seen[:, :2] / seen[:, 2:]) < edges).all(), places
