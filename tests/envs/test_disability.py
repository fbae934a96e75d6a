"""Settings of disability change the parts that they name, on every backend."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import assistax_envs
from assistax_envs import DISABILITY_SETTINGS, Disability, EnvState
from assistax_envs.tremor import BAND, TremorFilter
from tests.envs.conftest import (
    compiled,
    constant_actions,
    environment,
    native_and_mjx,
    play,
    start,
)

ELBOW = "human_right_elbow"


def test_settings_are_numbered_with_strength_running_fastest() -> None:
    assert [(s.elbow_range, s.strength) for s in DISABILITY_SETTINGS.values()] == [
        (1.0, 1.0), (1.0, 0.7), (1.0, 0.4), (0.7, 1.0), (0.7, 0.7), (0.7, 0.4), (0.4, 1.0), (0.4,
        0.7), (0.4, 0.4),
    ]  # fmt: skip
    assert list(DISABILITY_SETTINGS) == [f"d{i}" for i in range(1, 10)]


@native_and_mjx
def test_d9_narrows_the_elbow_in_a_batch(backend: str) -> None:
    model = environment("scratch", backend).model
    elbow = model.joint(ELBOW)
    state = start("scratch", backend, ["d1", "d9", "d3", "d7"])
    pushed = [
        play("scratch", backend, state, constant_actions(4, 60, 0.0, push))[-1]
        for push in (-1.0, 1.0)
    ]
    lows, highs = (np.asarray(last.physics.qpos)[:, elbow.qposadr[0]] for last in pushed)
    # The pose of rest, which no observation says.
    rest = environment("scratch", "native")._task.pose.angle[elbow.qposadr[0]]
    low, high = elbow.range
    assert highs[0] == pytest.approx(high, abs=0.06)
    assert highs[1] == pytest.approx(rest + 0.4 * (high - rest), abs=0.06)
    assert highs[3] == pytest.approx(
        rest + 0.4 * (high - rest), abs=0.06
    )  # d7: narrow, at full strength
    assert highs[2] > highs[1] + 0.3  # d3: weak, but with its whole range
    assert lows[0] < rest + 0.4 * (low - rest) - 0.05
    assert lows[1] == pytest.approx(rest + 0.4 * (low - rest), abs=0.06)


@pytest.mark.parametrize(("task", "left"), [("scratch", 0.4), ("gentle_bath", 0.7)])
def test_gentle_humans_are_spared_half_a_setting(task: str, left: float) -> None:
    env = environment(task, "native")
    full = {role: jnp.ones((2, size)) for role, size in env.action_size.items()}
    params = assistax_envs.disability_params(["d1", "d3"])
    # Torques are an input of the engine, which no state keeps.
    control = env._control(params, full, jnp.zeros(full["human"].shape))
    torques = np.asarray(control)[:, env._actuators["human"]]
    np.testing.assert_allclose(torques, np.outer([1.0, left], np.ones(torques.shape[1])), atol=1e-6)
    assert (torques[0] == 1.0).all()  # d1 to the bit
    # The range of joints is an input of the engine too.
    ranges = np.asarray(env._joint_range(assistax_envs.disability_params(["d1", "d7"])))
    assert (ranges[0] == np.asarray(env.model.jnt_range, np.float32)).all()
    wide, narrow = np.diff(ranges[:, env._stiff[0]])[:, 0]  # the joint that a setting narrows
    assert narrow == pytest.approx(left * wide)
    others = np.arange(env.model.njnt) != env._stiff[0]
    assert (ranges[1, others] == ranges[0, others]).all()


@native_and_mjx
def test_d9_weakens_every_joint_it_moves(backend: str) -> None:
    model = environment("scratch", backend).model
    dofs = [
        model.joint(f"human_{name}").dofadr[0]
        for name in ("right_shoulder1", "right_shoulder2", "right_elbow")
    ]
    same = jax.random.split(jax.random.key(0), 4)[
        jnp.zeros(4, jnp.int32)
    ]  # one start, four settings
    state = compiled("scratch", backend)[0](
        same, assistax_envs.disability_params(["d1", "d9", "d3", "d7"])
    )
    after = [
        play("scratch", backend, state, constant_actions(4, 1, 0.0, push))[-1]
        for push in (0.0, 0.5)
    ]
    idle, pushed = (np.asarray(last.physics.qvel)[:, dofs] for last in after)
    change = pushed - idle
    ratio = np.linalg.norm(change, axis=-1) / np.linalg.norm(change[0])
    np.testing.assert_allclose(ratio, [1.0, 0.4, 0.4, 1.0], atol=0.03)


def test_impossible_settings_are_refused() -> None:
    for bad in ({"strength": 0.0}, {"strength": 1.2}, {"elbow_range": -0.1}, {"tremor": 2.0}):
        with pytest.raises(ValueError, match="allowed is a share"):
            Disability(**bad)


def test_tremor_lies_between_4_and_12_hz() -> None:
    env = environment("scratch", "native")
    size, steps = 16, 500
    params = assistax_envs.disability_params([Disability(tremor=0.2)] * (size - 1) + [Disability()])
    state = jax.jit(env.reset)(jax.random.split(jax.random.key(0), size), params)

    def body(state: EnvState, step: jax.Array) -> tuple[EnvState, jax.Array]:
        # The torques of a tremor, which no state keeps.
        filtered, share = env._tremor.shake(
            state.tremor, state.key, jnp.full(size, step, jnp.int32), state.params.tremor
        )
        return dataclasses.replace(state, tremor=filtered), share

    torque = np.asarray(
        jax.jit(lambda state: jax.lax.scan(body, state, jnp.arange(steps))[1])(state)
    )  # [T, N, 3]
    assert np.all(torque[:, -1] == 0.0)  # the simulation without tremor stays calm
    shaking = torque[50:, :-1]
    spread = shaking.std()
    assert spread == pytest.approx(0.2, rel=0.05)
    assert abs(shaking.mean()) < 4 * 0.2 / np.sqrt(shaking.size / 10)
    power = np.square(np.abs(np.fft.rfft(shaking, axis=0))).mean((1, 2))
    frequency = np.fft.rfftfreq(len(shaking), 0.02)
    band = (frequency >= 4.0) & (frequency <= 12.0)
    assert power[band].sum() / power.sum() > 0.6
    assert power[band].mean() > 4 * power[~band].mean()


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_tremor_filter_is_a_butterworth_band_pass(rate: float) -> None:
    b, a = signal.butter(1, BAND, btype="bandpass", fs=rate)
    b /= np.sqrt(np.square(signal.lfilter(b, a, np.eye(1, 4096)[0])).sum())
    ours = TremorFilter(rate)
    # The filter's coefficients, beside SciPy's.
    np.testing.assert_array_equal(ours._b, b.astype(np.float32))
    np.testing.assert_array_equal(ours._a, a.astype(np.float32))


@native_and_mjx
def test_tremor_reaches_the_joints(backend: str) -> None:
    env = environment("scratch", backend)
    dof = env.model.joint(ELBOW).dofadr[0]
    settings = [Disability(), Disability(tremor=0.5), Disability(tremor=0.5), Disability()]
    same = jax.random.split(jax.random.key(0), 4)[jnp.zeros(4, jnp.int32)]
    state = compiled("scratch", backend)[0](same, assistax_envs.disability_params(settings))
    last = play("scratch", backend, state, constant_actions(4, 20, 0.0, 0.0))[-1]
    qvel = np.asarray(last.physics.qvel)[:, dof]
    assert abs(qvel[1]) > 5 * abs(qvel[0])
    assert qvel[0] == pytest.approx(qvel[3], abs=1e-6)
