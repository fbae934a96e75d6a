"""Pictures: what must be seen is seen, the same state gives the same bytes, and a machine that
cannot draw says so.
"""

import ctypes.util
import dataclasses
import importlib
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from assistax_envs import EnvState, gl
from assistax_envs.overlay import Figures, write
from assistax_envs.render import Renderer
from assistax_envs.tasks import TASK_CLASSES
from tests.envs.conftest import environment, start
from tests.system import needs

ROOT = Path(__file__).parents[2]
TASK = "scratch"
SIZE = {"width": 320, "height": 240}


@pytest.fixture(scope="module")
def two() -> EnvState:
    return start(TASK, "native", ["d1", "d1"], seed=0)


def coloured(frame: np.ndarray, kind: str) -> int:
    """Count the pixels of a marker: magenta targets, green forces."""
    red, green, blue = np.moveaxis(frame.astype(int), -1, 0)
    if kind == "target":
        return int(((red - green > 90) & (blue - green > 40)).sum())
    return int(((green - red > 90) & (green - blue > 60)).sum())


@pytest.mark.parametrize("task", TASK_CLASSES)
@pytest.mark.parametrize("camera", [None, "close"])
def test_a_picture_is_not_blank(task: str, camera: str | None):
    frame = environment(task, "native").render(start(task, "native", ["d1"]), camera=camera, **SIZE)
    assert frame.shape == (240, 320, 3) and frame.dtype == np.uint8
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 200
    assert frame.std() > 20.0


def test_the_same_state_gives_the_same_bytes_and_another_other_ones(two: EnvState):
    env = environment(TASK, "native")
    first, other = env.render(two, 0, **SIZE), env.render(two, 1, **SIZE)
    np.testing.assert_array_equal(env.render(two, 0, **SIZE), first)
    np.testing.assert_array_equal(Renderer(env.model, env._task, **SIZE).frame(two, 0), first)
    assert (other != first).any()


def test_the_target_is_seen(two: EnvState, monkeypatch: pytest.MonkeyPatch):
    env = environment(TASK, "native")
    assert coloured(env.render(two, **SIZE), "target") > 20
    monkeypatch.setattr(
        env._task, "targets", lambda state, readings: {"itch": jnp.full((1, 1, 3), jnp.nan)}
    )
    assert coloured(Renderer(env.model, env._task, **SIZE).frame(two), "target") == 0


def test_the_force_is_an_arrow_that_grows(two: EnvState, monkeypatch: pytest.MonkeyPatch):
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


def test_figures_are_written_on_a_copy():
    plain = np.full((120, 320, 3), 128, np.uint8)
    figures = Figures("scratch", {"reach_target": 0.5, "scratch": float("nan")}, 2.5, 0.1, True)
    written = write(plain, figures, ("robot zero",))
    assert (plain == 128).all() and (written != plain).any()
    fuller = write(
        plain,
        dataclasses.replace(figures, terms={"reach_target": 1.0, "scratch": 0.0}),
        ("robot zero",),
    )
    assert coloured(fuller, "force") > coloured(written, "force") > 0


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


def test_a_machine_without_opengl_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
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


@needs("libosmesa6", ctypes.util.find_library("OSMesa"))
def test_osmesa_steps_in_for_egl_and_draws_the_same(tmp_path: Path):
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


def test_a_closed_renderer_gives_its_context_back(two: EnvState):
    env = environment(TASK, "native")
    renderer = Renderer(env.model, env._task, 64, 48)
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
