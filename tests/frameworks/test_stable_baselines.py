"""Stable-Baselines3 and PyTorch: run by tools/frameworks.sh, where both are installed."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import assistax_zoo as az

torch = pytest.importorskip("torch", reason="see tools/frameworks.sh")
sb3 = pytest.importorskip("stable_baselines3", reason="see tools/frameworks.sh")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TASK, LENGTH = "scratch", 4


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", LENGTH)


def test_check_env_passes():
    from stable_baselines3.common.env_checker import check_env

    from assistax_envs.adapters.gymnasium import AssistaxEnv

    check_env(AssistaxEnv(TASK, lambda obs: np.full(3, 0.1)), skip_render_check=True)


def test_check_env_passes_on_a_vector_row():
    from stable_baselines3.common.env_checker import check_env

    from tests.envs.test_vector_adapters import Row

    check_env(Row(), skip_render_check=True)


def test_a_step_says_what_sb3_reads():
    from stable_baselines3.common.vec_env import VecMonitor

    env = VecMonitor(az.vector_env(TASK, 3, form="sb3", backend="native"))
    env.seed(4)
    start, rewards = env.reset(), []
    actions = np.random.default_rng(0).uniform(-1, 1, (LENGTH, 3, 7)).astype(np.float32)
    for action in actions:
        obs, reward, done, infos = env.step(action)
        rewards.append(reward)
    assert done.all() and env.get_attr("num_envs") == [3, 3, 3]
    for row, info in enumerate(infos):
        assert info["TimeLimit.truncated"] and info["is_success"] is False
        assert not np.allclose(info["terminal_observation"], obs[row])
        assert info["episode"]["r"] == pytest.approx(np.sum(rewards, axis=0)[row], abs=1e-5)
    assert env.step(actions[0])[3] == [{}, {}, {}]
    env.seed(4)
    np.testing.assert_array_equal(env.reset(), start)
    with pytest.raises(ValueError, match="cannot be called: all simulations are one environment"):
        env.env_method("render")


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_it_learns_a_little(algorithm: str):
    env = az.vector_env(TASK, 4, form="sb3", backend="native")
    options = {"PPO": {"n_steps": 8, "batch_size": 16}, "SAC": {"learning_starts": 8}}[algorithm]
    model = getattr(sb3, algorithm)("MlpPolicy", env, seed=0, device="cpu", **options)
    before = [value.clone() for value in model.policy.parameters()]
    model.learn(64)
    assert any(
        not torch.equal(old, new)
        for old, new in zip(before, model.policy.parameters(), strict=True)
    )


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_a_model_comes_back_from_its_evaluation(algorithm: str, tmp_path: Path):
    env = az.vector_env(TASK, 2, form="sb3", backend="native")
    model = getattr(sb3, algorithm)("MlpPolicy", env, seed=0, device="cpu")
    model.policy.set_training_mode(True)
    modes, chance = [part.training for part in model.policy.modules()], torch.get_rng_state()
    partners = "scratch/ippo-d1-s0-v1"
    az.evaluate(model, task=TASK, split="both", partners=partners, episodes=1, references=False)
    assert [part.training for part in model.policy.modules()] == modes and True in modes
    assert torch.equal(torch.get_rng_state(), chance)


def test_tensors_and_arrays_share_memory():
    env = az.vector_env(TASK, 2, arrays="jax", backend="native")
    obs, _ = env.reset(seed=0)
    assert torch.from_dlpack(obs).data_ptr() == obs.unsafe_buffer_pointer()
    action = torch.full((2, 7), 0.5)
    stepped = np.asarray(env.step(action)[0])
    env.reset(seed=0)
    np.testing.assert_array_equal(stepped, env.step(action.numpy())[0])
    env.reset(seed=0)
    mean, _ = torch.cat([action, action], dim=1).chunk(2, dim=1)  # with gaps between its rows
    np.testing.assert_array_equal(stepped, env.step(mean)[0])


def test_printed_pytorch_loop_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    out = tmp_path / "agent.pt"
    words = ["--task", TASK, "--envs", "4", "--steps", "256", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["ppo_torch.py", *words])
    runpy.run_path(str(ROOT / "docs" / "ppo_torch.py"), run_name="__main__")
    assert capfd.readouterr().out.count("return ") == 64 // LENGTH and out.stat().st_size > 1000
    source = (ROOT / "docs" / "ppo_torch.py").read_text(encoding="utf-8")
    assert len([line for line in source.splitlines() if line.strip()]) <= 80


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from tools import notebooks

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.delenv("JAX_NUMPY_RANK_PROMOTION", raising=False)
    few = """
import assistax_envs.env
from stable_baselines3 import PPO
assistax_envs.env.EPISODE_LENGTH = 20
learn = PPO.learn
PPO.learn = lambda model, steps, **options: learn(model, steps // 200, **options)
"""
    content = notebooks.run("stable_baselines", tmp_path, few)
    assert any("image/png" in output.get("data", {}) for output in content.cells[5].outputs)
    assert "M_test" in str(content.cells[-1].outputs)
