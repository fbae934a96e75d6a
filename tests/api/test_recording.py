"""Recorded episodes are those that were played: replayed, they come out the same."""

import json
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import assistax_zoo as az
from assistax_envs import disability_params, make
from assistax_zoo.shell.main import run
from evaluation.play.jobs import episode_seeds

ROBOT, HUMAN = "scratch/ippo-d1-s7-v1/robot", "scratch/ippo-d3-s0-v1/human"
STEPS = 12


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("recorded") / "new" / "pair.parquet"
    az.trajectories(
        ROBOT, HUMAN, task="scratch", out=out, episodes=2, steps=STEPS, seed=4, backend="native"
    )
    return out


def replay(table: pl.DataFrame, episode: int) -> tuple[np.ndarray, list[float]]:
    """Return observations and rewards of an episode's actions, played again."""
    env = make("scratch", "native")
    key = jax.random.key(np.uint32(episode_seeds(4, [episode], HUMAN)[0]))
    state = env.reset(key[None], disability_params(["d3"]))
    seen, rewards = [state.obs["robot"][0]], []
    rows = table.filter(episode=episode).drop_nulls("reward")
    for row in rows.iter_rows(named=True):
        actions = {role: jnp.float32([row[f"{role}_action"]]) for role in ("robot", "human")}
        state = env.step(state, actions)
        seen.append(state.obs["robot"][0])
        rewards.append(float(state.reward[0]))
    return np.asarray(seen), rewards


@pytest.mark.parametrize("episode", [0, 1])
def test_the_actions_lead_where_the_table_says(path: Path, episode: int) -> None:
    table = pl.read_parquet(path)
    seen, rewards = replay(table, episode)
    rows = table.filter(episode=episode)
    assert rows["step"].to_list() == list(range(STEPS + 1))
    np.testing.assert_allclose(rows["robot_observation"].to_numpy(), seen, atol=1e-4)
    np.testing.assert_allclose(rows["reward"].to_numpy()[:-1], rewards, atol=1e-5)
    terms = rows["term_reach_target"] + rows["term_scratch"]
    np.testing.assert_allclose(terms.to_numpy()[:-1], rewards, atol=1e-5)


def test_actions_of_another_step_lead_elsewhere(path: Path) -> None:
    table = pl.read_parquet(path)
    shifted = table.with_columns(pl.col("robot_action").shift(-3).over("episode"))
    seen, _ = replay(shifted.drop_nulls("robot_action"), 0)
    kept = table.filter(episode=0)["robot_observation"].to_numpy()[: len(seen)]
    assert np.abs(kept - seen).max() > 1e-3


def test_observations_imitate_actions(path: Path) -> None:
    """The recorded robot's own network gives the recorded actions for what it saw."""
    rows = pl.read_parquet(path).drop_nulls("reward")
    for policy, role in ((ROBOT, "robot"), (HUMAN, "human")):
        actor = az.open_zoo().partner(policy)
        acted = actor.act(rows[f"{role}_observation"].to_numpy())
        np.testing.assert_allclose(acted, rows[f"{role}_action"].to_numpy(), atol=1e-5)


def test_the_last_row_is_an_observation_alone(path: Path) -> None:
    last = pl.read_parquet(path).filter(pl.col("step") == STEPS)
    state = re.compile("episode|step|.*_observation|pose|velocity|target_.*")
    gains = [name for name in last.columns if not state.fullmatch(name)]
    assert last.select(gains).null_count().row(0) == (2,) * len(gains)
    assert set(gains) >= {"robot_action", "human_action", "reward", "force", "terminated"}
    seen = last.select("robot_observation", "human_observation", "pose", "target_itch")
    assert seen.null_count().row(0) == (0, 0, 0, 0)


def test_the_file_says_who_played(path: Path) -> None:
    about = json.loads(pl.read_parquet_metadata(path)["assistax"])
    registry = az.open_zoo().registry
    for role, policy in (("robot", ROBOT), ("human", HUMAN)):
        assert about[role] == {"policy": policy, "sha256": registry.policy(policy).sha256}
    assert about["disability"]["strength"] == 0.4
    assert (about["seed"], about["environment_version"]) == (4, 1)


@pytest.mark.slow
def test_an_episode_is_that_of_an_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", STEPS)
    job = {"task": "scratch", "episodes": 2, "seed": 4, "backend": "native"}
    played = az.cross_play(ROBOT, HUMAN, progress=False, **job).episodes.sort("episode")
    table = az.trajectories(ROBOT, HUMAN, **job)
    returns = table.group_by("episode").agg(pl.col("reward").sum()).sort("episode")
    np.testing.assert_allclose(returns["reward"], played["return"], atol=1e-3)
    ended = table.filter(pl.col("step") == STEPS - 1)["truncated"]
    assert ended.to_list() == [True, True]


@pytest.mark.slow
def test_the_command_and_the_preference(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "pair.parquet"
    words = ["--task", "gentle_scratch", "--robot", "zero", "--human", "random", "--json"]
    words += ["--episodes", "1", "--steps", "2", "--preference", "p9", "--backend", "native"]
    assert run(["trajectories", *words, "--out", str(out)]) == 0
    assert json.loads(capfd.readouterr().out) == {"out": str(out), "episodes": 1, "steps": 2}
    about = json.loads(pl.read_parquet_metadata(out)["assistax"])
    assert about["preference"] == "p9" and about["robot"] == {"policy": "zero", "sha256": None}
    words[words.index("2")] = "0"
    assert run(["trajectories", *words, "--out", str(out)]) == 1
    assert re.search("steps is 0; allowed", capfd.readouterr().err)
