"""Training from plain arguments, and what is read back."""

import jax.numpy as jnp
import pytest

import assistax_envs
from assistax_zoo.training import train
from population.networks.policy import Policy
from population.runs.logged_run import read_preset
from tests.population.toy_env import ToyEnv, match

SMALL = {"num_envs": 8, "rollout_steps": 10, "hidden": (8, 8), "minibatches": 2, "epochs": 1}


@pytest.fixture
def toy(monkeypatch):
    """A toy in the place of a task."""
    env = ToyEnv(match)
    env.task = "scratch"
    monkeypatch.setattr(assistax_envs, "make", lambda task, backend, version=None: env)


@pytest.mark.slow
def test_teams_come_back_with_paths_figures_and_policies(toy, tmp_path):
    options = {"disabilities": ("d1", "d9"), "seeds": 2, "self_play_episodes": 3}
    options |= {"folder": tmp_path / "run", "progress": False}
    run = train("scratch", steps=160, hyperparameters=SMALL, **options)
    assert run.folder == tmp_path / "run" and run.config.steps == 160
    names = ("d1-s0", "d1-s1", "d9-s0", "d9-s1")
    assert run.names == tuple(f"scratch/ippo-{name}" for name in names)
    assert run.training["steps"] == 160 and run.training["backend"] == "jax"
    for figures in run.self_play:
        assert figures is not None
        assert figures["mean_ci"][0] <= figures["mean"] <= figures["mean_ci"][1]
        assert figures["n"] == 3 and "ci" not in figures
    humans = run.policies["human"]
    assert humans.ids == tuple(f"{name}/human" for name in run.names)
    _, action = Policy(humans.spec).act(humans.row(3), (), jnp.zeros((5, 3)), jnp.zeros(5, bool))
    assert action.shape == (5, 2)


def test_run_without_folder_gets_a_temporary_one(toy, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    run = train("scratch", steps=80, hyperparameters=SMALL, self_play_episodes=0, progress=False)
    assert run.folder.parent == tmp_path and run.self_play == (None,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"disabilities": ("d1", "d11")}, "disability is 'd11'; allowed are d1"),
        ({"hyperparameters": {"speed": 1}}, "unknown hyperparameter speed"),
        ({"seeds": 0}, "a run has no members"),
    ],
)
def test_bad_arguments_are_named(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        train("scratch", **arguments, folder=tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_a_preset_file_stands_for_algorithm_and_hyperparameters(tmp_path):
    path = tmp_path / "preset.json"
    path.write_text('{"algorithm": "mappo", "hyperparameters": {"gamma": 0.95}}')
    assert read_preset(path) == read_preset(path, "mappo") == ("mappo", {"gamma": 0.95})
    with pytest.raises(ValueError, match="is a preset of mappo; give that algorithm"):
        read_preset(path, "ippo")
    path.write_text("[1]")
    message = r"preset\.json is not a preset .* give a JSON object with algorithm"
    with pytest.raises(ValueError, match=message):
        read_preset(path)
