"""What our scenes use little or not at all: planted in small models, against MuJoCo."""

import copy
import functools

import mujoco
import numpy as np
import pytest

from tests.envs.fused.scenes import (
    Engine,
    States,
    oracle,
    relative_error,
    scene,
    sensitivity,
    team_states,
)

HEAD = """
<mujoco>
  <compiler angle="radian"/>
  <option integrator="implicitfast" timestep="0.004" impratio="{impratio}" gravity="1 2 -9"/>
  <default>
    <geom contype="0" conaffinity="0" density="2000"/>
    <joint damping="0.3" armature="0.01"/>
    <pair condim="3" friction="0.7 0.7"/>
  </default>
"""
# Three trees; a joint without a limit, one with a reference angle and a spring, one with its own
# softness; half a body's weight compensated; two motors on one joint, one of them clamped;
# every kind of pair, some given in the other order; sensors of each kind, one of the world.
MIXED = (
    HEAD
    + """
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" zaxis="0.1 0.2 1"/>
    <geom name="post" type="capsule" fromto="0.3 0 0.1 0.3 0.1 0.6" size="0.05"/>
    <site name="corner" pos="1 2 3" quat="1 2 3 4"/>
    <body name="a" pos="0 0 0.25" euler="0.1 0.2 0.3" gravcomp="0.5">
      <joint name="a1" axis="1 2 3" pos="0.01 0.02 0"/>
      <joint name="a2" axis="0 1 0" range="-0.6 0.6" limited="true" ref="0.3" stiffness="7"
             springref="0.1" solreflimit="0.05 0.7" solimplimit="0.7 0.9 0.03 0.3 2"/>
      <geom name="a" type="capsule" fromto="0 0 0 0.25 0 0" size="0.06"/>
      <body name="a_end" pos="0.25 0 0">
        <joint name="a3" axis="0 0 1" range="-2 -0.5" limited="true" solreflimit="-900 -30"/>
        <geom name="tip" type="sphere" pos="0.15 0.02 0" size="0.07"/>
        <body name="welded" pos="0.1 0.1 0" euler="1 0 0" gravcomp="1">
          <geom name="welded" type="capsule" size="0.03 0.1"/>
          <site name="s" pos="0.05 0 0.02" euler="0.3 0.2 0.1"/>
        </body>
      </body>
    </body>
    <body name="b" pos="0.1 0.3 0.3">
      <joint name="b1" axis="0 0 1"/>
      <joint name="b2" axis="1 1 0" range="-1 1" limited="true"/>
      <geom name="b" type="capsule" fromto="0 0 0 0 -0.3 0.2" size="0.05"/>
    </body>
    <body name="c" pos="0.2 -0.1 0.2">
      <joint name="c1" axis="1 0 0"/>
      <geom name="c" type="sphere" pos="0 0.1 0.05" size="0.1"/>
    </body>
  </worldbody>
  <contact>
    <pair geom1="floor" geom2="tip"/>
    <pair geom1="a" geom2="floor" solref="0.1 0.5" friction="1.2 1.2"/>
    <pair geom1="floor" geom2="b"/>
    <pair geom1="c" geom2="floor" solimp="0.8 0.99 0.01 0.6 2"/>
    <pair geom1="a" geom2="b" solref="-2000 -50"/>
    <pair geom1="b" geom2="tip" friction="0.2 0.2"/>
    <pair geom1="tip" geom2="c"/>
    <pair geom1="c" geom2="b"/>
    <pair geom1="post" geom2="a"/>
    <pair geom1="post" geom2="tip"/>
    <pair geom1="welded" geom2="b"/>
    <pair geom1="welded" geom2="a"/>
  </contact>
  <actuator>
    <motor joint="a1" gear="3"/>
    <motor joint="b2" gear="2" ctrlrange="-0.5 0.4" ctrllimited="true"/>
    <motor joint="b2" gear="-1"/>
  </actuator>
  <sensor>
    <contact geom1="a" geom2="floor" data="force" reduce="maxforce"/>
    <contact geom1="tip" geom2="b" data="force" reduce="maxforce"/>
    <contact geom1="tip" geom2="c" data="force" reduce="maxforce"/>
    <contact geom1="c" geom2="floor" data="force" reduce="maxforce"/>
    <jointpos joint="a2"/><jointvel joint="b1"/>
    <framepos objtype="site" objname="s"/><framequat objtype="site" objname="s"/>
    <framelinvel objtype="site" objname="s"/>
    <framepos objtype="site" objname="corner"/><framequat objtype="site" objname="corner"/>
    <framelinvel objtype="site" objname="corner"/>
  </sensor>
</mujoco>
"""
)
# A capsule that rolls about its own axis above parallel ones, one of them beyond its end.
PARALLEL = (
    HEAD
    + """
  <worldbody>
    <geom name="long" type="capsule" fromto="-0.5 0 0.05 0.5 0 0.05" size="0.05"/>
    <geom name="short" type="capsule" fromto="0.1 0.1 0.05 0.2 0.1 0.05" size="0.05"/>
    <geom name="line" type="capsule" fromto="0.45 0 0.15 0.8 0 0.15" size="0.05"/>
    <body name="arm" pos="0 0 0.6">
      <joint name="swing" axis="1 0 0" pos="0 0 0.3"/>
      <geom type="sphere" size="0.05"/>
      <body name="roller" pos="0 0.02 -0.47">
        <joint name="roll" axis="1 0 0"/>
        <geom name="roller" type="capsule" fromto="-0.2 0 0 0.25 0 0" size="0.04"/>
      </body>
    </body>
  </worldbody>
  <contact>
    <pair geom1="roller" geom2="long"/>
    <pair geom1="short" geom2="roller"/>
    <pair geom1="roller" geom2="line"/>
  </contact>
  <sensor>
    <contact geom1="roller" geom2="long" data="force" reduce="maxforce"/>
    <contact geom1="roller" geom2="short" data="force" reduce="maxforce"/>
  </sensor>
</mujoco>
"""
)


@functools.cache
def planted(name: str) -> tuple[mujoco.MjModel, Engine]:
    text, impratio = {"mixed": (MIXED, 1), "stiff": (MIXED, 4), "parallel": (PARALLEL, 1)}[name]
    model = mujoco.MjModel.from_xml_string(text.format(impratio=impratio))
    return model, Engine(model)


def states_of(model: mujoco.MjModel, n: int, seed: int, spread: float) -> States:
    rng = np.random.default_rng(seed)
    qpos = model.qpos0 + rng.uniform(-spread, spread, (n, model.nq))
    return States(qpos, rng.normal(size=(n, model.nv)), rng.uniform(-1.5, 1.5, (n, model.nu)))


def contacts(model: mujoco.MjModel, states: States) -> np.ndarray:
    """Return the number of contacts of each geom pair [N, ngeom, ngeom]."""
    counts = np.zeros((len(states), model.ngeom, model.ngeom), int)
    data = mujoco.MjData(model)
    for i in range(len(states)):
        data.qpos[:] = states.qpos[i]
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            counts[i][tuple(sorted(contact.geom))] += 1
    return counts


@pytest.mark.parametrize("name", ["mixed", "stiff"])
def test_mixed_model(name: str) -> None:
    model, engine = planted(name)
    states = states_of(model, 400, seed=5, spread=2.5)
    touching = contacts(model, states)
    shallow = touching.sum(axis=(1, 2)) <= 8
    states, touching = states[shallow], touching[shallow]
    _, velocity, sensors = oracle(model, states)
    _, got, sensed = engine(states)
    error = relative_error(got, velocity, states.qvel)
    assert (touching.any(axis=0)).sum() == model.npair, "some pair never touched"
    assert np.median(error) < 2e-6 and error.max() < 5e-4
    forces, scale = slice(0, 12), np.abs(sensors[:, :12]).max(axis=1, keepdims=True) + 1.0
    wrong = np.abs(sensed[:, forces] - sensors[:, forces]) / scale
    assert wrong.max() < 1e-3 and (np.abs(sensors[:, forces]) > 0).any(axis=0).all()
    np.testing.assert_allclose(sensed[:, 12:], sensors[:, 12:], atol=5e-6)


def test_parallel_capsules_touch_twice() -> None:
    model, engine = planted("parallel")
    states = states_of(model, 200, seed=6, spread=0.12)
    touching = contacts(model, states)
    assert (touching == 2).sum() > 50, "no pair touched in two places"
    _, velocity, sensors = oracle(model, states)
    _, got, sensed = engine(states)
    assert relative_error(got, velocity, states.qvel).max() < 3e-4
    scale = np.abs(sensors).max(axis=1, keepdims=True) + 1.0
    assert (np.abs(sensed - sensors) / scale).max() < 1e-3


def test_a_softer_scene_is_another_program() -> None:
    """Skin that yields, a stiffer trunk, a weaker robot: the model's numbers, not the engine's."""
    model = copy.copy(scene("scratch"))
    model.pair_solref[:, 0] = np.linspace(0.02, 0.08, model.npair)
    model.pair_solimp[:, 0] = np.linspace(0.5, 0.9, model.npair)
    model.jnt_stiffness[:3] *= 3.0
    model.dof_damping[:3] *= 3.0
    model.actuator_gear[:7] *= 0.3
    states, ranges = team_states("scratch")
    states, ranges = states[:60], ranges[:60]
    _, want, _ = oracle(model, states, 1, ranges)
    error = np.linalg.norm(Engine(model)(states, 1, ranges)[1] - want, axis=1)
    change = np.linalg.norm(want - states.qvel, axis=1)
    assert (error / (1e-6 * (1 + change) + sensitivity(model, states, 1, ranges))).max() < 10
