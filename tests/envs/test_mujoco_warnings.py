"""MuJoCo's warnings: no file in the user's folder, and those that matter are told."""

import logging
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

from assistax_envs import disability_params, make
from assistax_envs.mujoco_warnings import warnings_logged
from assistax_envs.own_settings import key_of

LOG = "MUJOCO_LOG.TXT"
FALLING = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"


def diverge() -> None:
    model = mujoco.MjModel.from_xml_string(FALLING)
    data = mujoco.MjData(model)
    data.qpos[0] = np.nan
    mujoco.mj_step(model, data)


def test_a_diverging_simulation_leaves_no_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    env = make("scratch", "native")
    state = jax.jit(env.reset)(key_of(np.arange(2, dtype=np.uint32)), disability_params(["d1"] * 2))
    far = state.physics.qpos.at[0, 0].set(np.nan)
    broken = jax.tree.map(lambda leaf: leaf, state)
    object.__setattr__(broken.physics, "qpos", far)
    action = {"robot": np.zeros((2, 7), np.float32), "human": np.zeros((2, 3), np.float32)}
    after = jax.block_until_ready(jax.jit(env.step)(broken, action))
    assert after.nonfinite.tolist() == [True, False]  # which is what a study counts
    assert not (tmp_path / LOG).exists()
    assert not caplog.records and "WARNING" not in capfd.readouterr().err
    assert mujoco.get_mju_user_warning() is None


def test_by_itself_mujoco_leaves_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with warnings_logged():
        diverge()
    assert not (tmp_path / LOG).exists()
    diverge()
    assert (tmp_path / LOG).exists()


def test_other_warnings_are_told(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING), warnings_logged():
        told = mujoco.get_mju_user_warning()
        told("The contact buffer is full")
        told("Nan in QPOS at DOF 0. The simulation is unstable. Time = 0.0000.")
    assert [record.message for record in caplog.records] == ["The contact buffer is full"]


def test_a_users_own_handler_hears_them() -> None:
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        with warnings_logged():
            diverge()
    finally:
        mujoco.set_mju_user_warning(None)
    assert len(heard) == 1 and "unstable" in heard[0]
