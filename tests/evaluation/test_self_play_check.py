"""Replay of self-play against a registry's records."""

import dataclasses
import fnmatch
import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_workshop.press.publish import publish
from evaluation.replay import self_play_check
from evaluation.replay.self_play_check import SelfPlayReport, check_self_play, tolerance, versions
from population.networks.spec import PolicySpec
from population.runs.trained import TrainedTeam
from tests.population.toy_env import ToyEnv, constant
from tests.untrained import params_of
from zoo.registry import Registry, load_registry
from zoo.schema import SelfPlay

ROOT = Path(__file__).parents[2]
RETURN = 20.0  # of the toy environment: 20 steps at reward 1
RECORDED = {"mean": RETURN, "iqm": RETURN, "mean_ci": [19.5, 20.5], "n": 16}
SPECS = {
    "robot": PolicySpec("robot", 2, 1, hidden=(4,)),
    "human": PolicySpec("human", 3, 2, hidden=(4,)),
}


def trained(
    seed: int, disability: str = "d1", specs: Any = SPECS, self_play: Any = RECORDED
) -> TrainedTeam:
    params = {role: params_of(spec, 10 * seed + len(role)) for role, spec in specs.items()}
    training = {"run": "r", "steps": 1, "env_version": 1, "backend": "jax"}
    return TrainedTeam("scratch", "ippo", disability, seed, specs, params, training, self_play)


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    lone = {"robot": SPECS["robot"]}
    wide = {**SPECS, "robot": PolicySpec("robot", 2, 1, hidden=(6,))}
    teams = [trained(0), trained(1, "d9"), trained(2, self_play=None)]
    teams += [trained(3, specs=lone), trained(4, specs=wide)]
    return published(teams, tmp_path)


def published(teams: list[TrainedTeam], folder: Path, version: int = 1) -> Registry:
    path, environments = folder / "registry.json", {"scratch": version}
    return publish(teams, path, "v0", environments=environments, date="2027-01-31")


def recording(registry: Registry, pattern: str = "*", **figures: Any) -> Registry:
    """Return the registry with other self-play figures of some teams."""
    data = json.loads(registry.path.read_text())
    for name, team in data["teams"].items():
        if "self_play" in team and fnmatch.fnmatch(name, pattern):
            team["self_play"].update(figures)
    registry.path.write_text(json.dumps(data))
    return load_registry(registry.path, roots=False)


def check(
    registry: Registry, pattern: str | None = None, env: Any = None, **arguments: Any
) -> SelfPlayReport:
    made = env or ToyEnv(constant)
    return check_self_play(
        registry,
        registry.select(pattern),
        episodes=2,
        make_env=lambda task, backend, version=None: made,
        **arguments,
    )


def test_complete_teams_are_replayed(registry: Registry) -> None:
    told: list[int] = []
    report = check(registry, on_progress=told.append)
    assert report.ok and report.policies == 9 and sum(told) == 4 and report.backend == "jax"
    by_team = {team.team: team for team in report.teams}
    expected = {"d1-s0": RETURN, "d9-s1": RETURN, "d1-s2": None, "d1-s4": RETURN}
    assert {name: team.expected for name, team in by_team.items()} == {
        f"scratch/ippo-{name}-v0": value for name, value in expected.items()
    }
    assert all(team.found == RETURN for team in report.teams)
    assert [drift.found for drift in report.drifts] == [0.0]
    assert json.loads(json.dumps(report.to_json()))["ok"] is True
    assert len(check(registry, "*-s0-*").teams) == 1 and check(registry, "*/robot").teams == ()


def test_another_return_is_a_problem_of_its_team(registry: Registry) -> None:
    report = check(recording(registry, "scratch/ippo-d9-s1-v0", mean=26.0, mean_ci=[25.9, 26.1]))
    assert [team.team for team in report.teams if not team.ok] == ["scratch/ippo-d9-s1-v0"]
    assert "expected a self-play return of 26.0 within" in report.problems[0]
    assert "found 20.0" in report.problems[0]
    assert [team.episodes for team in report.teams if not team.ok] == [32]
    assert {team.episodes for team in report.teams if team.ok} == {2}


def test_failing_team_plays_more_episodes(
    registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    play, calls = self_play_check.play, []

    def unlucky(env: Any, job: Any, max_envs: int) -> Any:
        calls.append((len(job.egos.ids), job.episodes))
        table = play(env, job, max_envs)
        failed = (pl.col("ego_seed") == 0) & (len(calls) == 1)
        return table.with_columns(
            pl.when(failed).then(RETURN / 2).otherwise("return").alias("return")
        )

    monkeypatch.setattr(self_play_check, "play", unlucky)
    report = check(registry, "scratch/ippo-d?-s[01]-v0")
    assert calls == [(2, 2), (1, 32)] and report.ok
    assert [(team.found, team.episodes) for team in report.teams] == [(RETURN, 32), (RETURN, 2)]


@pytest.mark.parametrize(("every", "ok"), [(8, True), (1, False)])
def test_rare_episodes_are_no_difference(
    registry: Registry, monkeypatch: pytest.MonkeyPatch, every: int, ok: bool
) -> None:
    """One episode in eight, or each, earns ten times the recorded return."""
    play = self_play_check.play

    def played(env: Any, job: Any, max_envs: int) -> Any:
        rich = pl.col("episode") % every == 0
        earned = pl.col("return") * pl.when(rich).then(10.0).otherwise(1.0)
        return play(env, job, max_envs).with_columns(earned.alias("return"))

    monkeypatch.setattr(self_play_check, "play", played)
    [team] = check(registry, "scratch/ippo-d1-s0-v0").teams
    assert team.ok is ok and team.episodes == 32


def test_common_drift_is_found(registry: Registry) -> None:
    """Physics that gives 3.8 % less to everyone."""
    report = check(recording(registry, mean=20.8, mean_ci=[20.799, 20.801]))
    assert all(team.ok for team in report.teams) and not report.ok
    assert "-3.8%" in report.problems[0] and "mujoco 3." in report.problems[0]


def test_every_team_plays_under_its_own_disability(registry: Registry) -> None:
    seen: list[Any] = []

    class Watched(ToyEnv):
        def reset(self, keys: Any, params: Any) -> Any:
            import jax

            jax.debug.callback(lambda value: seen.append(np.asarray(value)), params.strength)
            return super().reset(keys, params)

    check(registry, "scratch/ippo-d?-s[01]-v0", Watched(constant))
    np.testing.assert_allclose(seen[0], [1.0, 1.0, 0.4, 0.4], rtol=1e-6)


def test_damaged_policies_are_problems(registry: Registry) -> None:
    lone = registry.policy("scratch/ippo-d1-s4-v0/robot")
    path = registry.shard_path(lone.shard)
    path.write_bytes(path.read_bytes()[:-1])
    report = check(registry)
    assert not report.ok and "bytes, found" in report.problems[0] and len(report.teams) == 3
    other = check(registry, "*-s[01]-*", ToyEnv(constant, observation_size=(5, 3, 4)))
    message = "reads observations of 2 numbers; the robot of task toy has 5"
    assert not other.teams and message in other.problems[0]


def test_misshapen_parameters_are_a_problem(tmp_path: Path) -> None:
    team = trained(0)
    human = {name: value for name, value in team.params["human"].items() if name != "Dense_1"}
    team = dataclasses.replace(team, params={**team.params, "human": human})
    registry = publish(
        [team], tmp_path / "registry.json", "v0", check=lambda spec, leaves, source: None
    )
    report = check(registry)
    assert "cannot be stepped" in report.problems[0] and report.teams == ()


def test_other_version_teams_are_only_stepped(tmp_path: Path) -> None:
    teams = [
        dataclasses.replace(team, training={**team.training, "env_version": 7})
        for team in (trained(0), trained(1))
    ]
    report = check(published(teams, tmp_path, 7))
    assert report.ok and report.policies == 4 and report.teams == ()
    assert report.outdated == ("scratch/ippo-d1-s0-v0", "scratch/ippo-d1-s1-v0")


def test_the_tolerance_is_the_documented_one() -> None:
    # Standard error 5, deviation 20.
    recorded = SelfPlay(mean=1000.0, iqm=1000.0, mean_ci=(990.2, 1009.8), n=16)
    assert tolerance(recorded, 4) == pytest.approx(50.0 + 4.0 * 20.0 * np.sqrt(1 / 16 + 1 / 4))
    with pytest.raises(ValueError, match="episodes is 0"):
        check_self_play(Registry(None, Path(), []), [], episodes=0)
    assert versions()["mujoco"].startswith("3.") and "jax" in versions()


@pytest.mark.slow
def test_team_of_v1_reproduces_record() -> None:
    registry = load_registry(ROOT / "registry.json")
    entries = registry.select("scratch/ippo-d1-s0-v1")
    report = check_self_play(registry, entries, episodes=2)
    assert report.ok and report.policies == 2 and report.backend == "native"
    [team] = report.teams
    assert team.tolerance is not None and team.expected is not None
    assert abs(team.found / 2 - team.expected) > team.tolerance  # half would be seen
