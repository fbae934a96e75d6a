"""Other libraries' own checks of our adapters, and each adapter against the environment itself."""

import subprocess
import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs.adapters.jaxmarl import AssistaxMarlEnv, Box
from assistax_envs.adapters.simulation import Simulation

ROOT = Path(__file__).parents[2]
TASK = "scratch"
ZERO = {"robot": jnp.zeros(7), "human": jnp.zeros(3)}


@pytest.fixture(scope="module")
def marl() -> AssistaxMarlEnv:
    """JaxMARL's interface, with episodes of four steps."""
    env = AssistaxMarlEnv(TASK, "d3", backend="native")
    env.env.episode_length = 4
    return env


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 5)
    return 5


@pytest.mark.slow
@pytest.mark.parametrize("make_key", [jax.random.key, jax.random.PRNGKey], ids=["typed", "raw"])
def test_jaxmarl_is_the_environment_on_one_simulation(marl: AssistaxMarlEnv, make_key):
    obs, state = jax.jit(marl.reset)(make_key(1))
    assert {agent: value.shape for agent, value in obs.items()} == {"robot": (34,), "human": (38,)}
    params = assistax_envs.disability_params(["d3"])
    expected = marl.env.reset(jax.random.key(1)[None], params)
    np.testing.assert_array_equal(obs["robot"], expected.obs["robot"][0])
    obs, state, rewards, dones, infos = jax.jit(marl.step)(make_key(2), state, ZERO)
    expected = jax.jit(marl.env.step)(
        expected, {role: action[None] for role, action in ZERO.items()}
    )
    np.testing.assert_allclose(obs["human"], expected.obs["human"][0], atol=1e-6)
    assert set(rewards) == set(dones) == {"robot", "human", "__all__"}
    np.testing.assert_allclose(rewards["__all__"], expected.reward[0], rtol=1e-5)
    assert not dones["__all__"]
    assert state.step == 1
    assert {value.shape for value in infos.values()} == {(2,)}


@pytest.mark.slow
def test_jaxmarl_under_vmap_is_its_batch(marl: AssistaxMarlEnv):
    keys = jax.random.split(jax.random.key(3), 3)
    actions = {"robot": jnp.full((3, 7), 0.3), "human": jnp.full((3, 3), -0.2)}

    def play(reset, step):
        _, state = reset(keys)
        return step(keys, state, actions)

    mapped = jax.jit(lambda: play(jax.vmap(marl.reset), jax.vmap(marl.step)))()
    batch = jax.jit(lambda: play(marl.reset_batch, marl.step_batch))()
    for left, other in zip(
        jax.tree.leaves((mapped[0], mapped[2])), jax.tree.leaves((batch[0], batch[2])), strict=True
    ):
        np.testing.assert_allclose(left, other, atol=1e-6)


def test_jaxmarl_resets_the_done_and_only_them(marl: AssistaxMarlEnv):
    def play(key):
        def body(state, key):
            obs, state, _, dones, _ = jax.vmap(marl.step, in_axes=(0, 0, None))(
                jax.random.split(key, 2), state, ZERO
            )
            return state, (state.step, dones["__all__"], obs["robot"])

        _, state = jax.vmap(marl.reset)(jax.random.split(key, 2))
        state = assistax_envs.select(jnp.array([True, False]), state, _at_step(state, 2))
        return jax.lax.scan(body, state, jax.random.split(key, 4))[1]

    # Seeds are mapped over too, as JaxMARL's scripts do.
    steps, dones, obs = jax.jit(jax.vmap(play))(jax.random.split(jax.random.key(5), 2))
    np.testing.assert_array_equal(steps[0], [[1, 3], [2, 0], [3, 1], [0, 2]])
    np.testing.assert_array_equal(dones[0], [[0, 0], [0, 1], [0, 0], [1, 0]])
    assert np.isfinite(obs).all()
    assert not np.array_equal(obs[0], obs[1])


def _at_step(state, step: int):
    import dataclasses

    return dataclasses.replace(state, step=jnp.full_like(state.step, step))


@pytest.mark.slow
def test_jaxmarl_resets_to_the_state_that_is_given(marl: AssistaxMarlEnv):
    _, start = marl.reset(jax.random.key(8))
    _, state = marl.reset(jax.random.key(9))
    state = _at_step(state, 3)
    obs, after, _, dones, _ = jax.jit(marl.step)(jax.random.key(0), state, ZERO, start)
    assert dones["__all__"]
    np.testing.assert_array_equal(after.physics.qpos, start.physics.qpos)
    np.testing.assert_array_equal(obs["human"], start.obs["human"])
    assert jax.jit(marl.step_env)(jax.random.key(0), state, ZERO)[1].step == 4


def test_jaxmarl_spaces_have_its_fields(marl: AssistaxMarlEnv):
    space = marl.action_space("robot")
    assert (space.low, space.high, space.shape) == (-1.0, 1.0, (7,))
    drawn = space.sample(jax.random.key(0))
    assert drawn.shape == (7,) and space.contains(drawn)
    assert not space.contains(drawn.at[0].set(1.5))
    assert marl.observation_space("human").sample(jax.random.key(1)).shape == (38,)
    assert Box(0.0, 2.0, (1000,)).sample(jax.random.key(2)).max() > 1.0
    assert marl.get_world_state(marl.reset(jax.random.key(0))[1]).shape == (52,)


def test_pettingzoo_passes_its_own_test(short: int):
    from pettingzoo.test import parallel_api_test

    from assistax_envs.adapters.pettingzoo import parallel_env

    parallel_api_test(parallel_env(TASK), num_cycles=12)


def test_pettingzoo_is_truncated_at_the_horizon_and_reproducible(short: int):
    from gymnasium.spaces import Box

    from assistax_envs.adapters.pettingzoo import AssistaxParallelEnv

    env = AssistaxParallelEnv(TASK)
    with pytest.raises(ValueError, match="call reset"):
        env.state()
    starts = [env.reset(seed=4)[0]["robot"], env.reset()[0]["robot"], env.reset(seed=4)[0]["robot"]]
    np.testing.assert_array_equal(starts[0], starts[2])
    assert not np.array_equal(starts[0], starts[1])
    actions = {"robot": np.zeros(7), "human": np.zeros(3)}
    for step in range(short):
        assert env.agents == ["robot", "human"]
        obs, rewards, terminated, truncated, infos = env.step(actions)
        assert truncated == dict.fromkeys(env.possible_agents, step == short - 1)
    assert terminated == dict.fromkeys(env.possible_agents, False)
    assert (
        rewards["robot"]
        == rewards["human"]
        == pytest.approx(sum(infos["robot"]["terms"].values()), rel=1e-5)
    )
    assert env.state().shape == (52,)
    for agent in env.possible_agents:
        space = env.observation_space(agent)
        assert space.contains(obs[agent])
        assert isinstance(space, Box) and space.is_bounded()
    assert env.agents == [] and env.step(actions) == ({}, {}, {}, {}, {})


def test_gymnasium_passes_its_own_check():
    from gymnasium.utils.env_checker import check_env

    from assistax_envs.adapters.gymnasium import AssistaxEnv

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*spec")
        check_env(AssistaxEnv(TASK, lambda obs: np.full(3, 0.1)), skip_render_check=True)


def test_gymnasium_is_registered_on_request_only(short: int):
    import gymnasium

    assert not [name for name in gymnasium.registry if name.startswith("assistax/")]
    from assistax_envs.adapters import gymnasium as adapter

    ids = adapter.register()
    assert f"assistax/{TASK}-v{assistax_envs.VERSIONS[TASK]}" in ids and adapter.register() == ids
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = gymnasium.make(f"assistax/{TASK}-v{assistax_envs.VERSIONS[TASK]}", disability="d9")
    env.reset(seed=1)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(short)]
    assert ends == [(False, False)] * (short - 1) + [(False, True)]
    with pytest.raises(ValueError, match=r"ended at step 5; call reset\(\)"):
        env.step(env.action_space.sample())
    for name in ids:
        del gymnasium.registry[name]


class Partner:
    """Remembers what it was asked."""

    setting = assistax_envs.DISABILITY_SETTINGS["d9"]

    def __init__(self) -> None:
        self.resets, self.seen = 0, []

    def reset(self) -> None:
        self.resets += 1

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        self.seen.append(obs)
        return np.full(3, 0.5)


def test_gymnasium_seats_the_partner_with_its_disability():
    from assistax_envs.adapters.gymnasium import AssistaxEnv

    partner = Partner()
    env = AssistaxEnv(TASK, partner)
    env.reset(seed=0)
    obs, reward, *_ = env.step(np.full(7, 0.2, np.float32))
    assert partner.resets == 1
    simulation = Simulation(TASK, "d9")
    simulation.reset(np.random.default_rng(np.random.SeedSequence(0)))
    np.testing.assert_array_equal(partner.seen[0], simulation.observation("human"))
    simulation.step({"robot": np.full(7, 0.2), "human": np.full(3, 0.5)})
    np.testing.assert_array_equal(obs, simulation.observation("robot"))
    assert reward == float(simulation.state.reward[0])


def test_wrong_arguments_say_what_is_allowed(short: int):
    from assistax_envs.adapters.gymnasium import AssistaxEnv
    from assistax_envs.adapters.pettingzoo import AssistaxParallelEnv

    with pytest.raises(
        ValueError, match="render_mode is 'human'; allowed are None and 'rgb_array'"
    ):
        AssistaxEnv(TASK, render_mode="human")
    with pytest.raises(ValueError, match="render_mode is 'ansi'"):
        AssistaxParallelEnv(TASK, render_mode="ansi")
    with pytest.raises(ValueError, match="task is 'swim'; allowed are"):
        AssistaxParallelEnv("swim")
    env = AssistaxParallelEnv(TASK)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="no action for 'human'"):
        env.step({"robot": np.zeros(7)})
    with pytest.raises(ValueError, match=r"action of 'robot' has shape \(3,\); expected \(7,\)"):
        env.step({"robot": np.zeros(3), "human": np.zeros(3)})


@pytest.mark.parametrize(
    ("module", "missing"),
    [("gymnasium", "gymnasium"), ("pettingzoo", "pettingzoo")],
)
def test_a_missing_package_names_the_extra(module: str, missing: str):
    script = f"import sys; sys.modules[{missing!r}] = None; import assistax_envs.adapters.{module}"
    result = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 1
    last = result.stderr.strip().splitlines()[-1]
    assert last == (
        f"ImportError: this adapter needs the package {missing}; install it with: pip install "
        "'assistax-zoo[adapters]'"
    )


@pytest.mark.slow
def test_stable_baselines3_trains():
    sb3 = pytest.importorskip("stable_baselines3")
    from assistax_envs.adapters.gymnasium import AssistaxEnv

    model = sb3.PPO(
        "MlpPolicy", AssistaxEnv(TASK, Partner()), n_steps=128, batch_size=64, n_epochs=2, seed=0
    )
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(384)
    after = list(model.policy.parameters())
    assert model.num_timesteps == 384
    assert all(bool(parameter.isfinite().all()) for parameter in after)
    assert any(not bool((a == b).all()) for a, b in zip(before, after, strict=True))
