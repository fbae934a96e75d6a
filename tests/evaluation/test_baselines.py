from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from assistax_envs.tasks.chain import Script
from evaluation.cast.baseline_policies import (
    ReferencePolicy,
    ReferenceSpec,
    ScriptedPolicy,
    ScriptSpec,
)
from evaluation.cast.roster import Roster
from evaluation.figures.normalised import (
    COLUMN,
    CROSS_PLAY,
    NONE,
    PASSIVE,
    RANDOM,
    SCRIPT,
    SELF_PLAY,
    ZERO,
    BoundsUsed,
    WorstRegret,
    bounds_table,
    summarise_references,
)
from evaluation.play.baselines import play_references, script_roster
from evaluation.play.evaluator import run_job
from evaluation.play.jobs import Job
from evaluation.play.progress import Progress
from evaluation.record import tables
from population.networks.stack import PolicyStack
from tests.evaluation.episode_tables import Team, episode_table, recorded, team_id, teams
from tests.evaluation.matrix_game import (
    HUMAN,
    PAYOFF,
    ROBOT,
    MatrixGame,
    host,
    humans,
    random_roster,
    robots,
)


def job_of(egos: Roster, partners: Roster, **options: Any) -> Job:
    return Job("matrix", 1, "native", egos, partners, episodes=3, **options)


@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("stochastic", [False, True])
def test_self_play_reference_equals_matrix_diagonal(tmp_path: Path, stochastic: bool):
    egos, partners = random_roster(ROBOT, 5, 1), random_roster(HUMAN, 5, 2)
    job = job_of(egos, partners, stochastic=stochastic)
    whole = run_job(MatrixGame(), job, tmp_path / "all").table
    diagonal = whole.filter(pl.col("ego_seed") == pl.col("partner_seed"))
    for max_envs in (1000, 4):
        paired = job_of(egos, partners, paired=True, stochastic=stochastic)
        own = run_job(MatrixGame(), paired, tmp_path / str(max_envs), max_envs=max_envs).table
        # Another program: where actions are drawn, a last bit differs on some processors.
        assert_frame_equal(own, diagonal, check_exact=not stochastic, rel_tol=1e-6, abs_tol=0)
    assert whole.height == 5 * diagonal.height == 75


def test_pairs_need_as_many_robots_as_humans():
    with pytest.raises(ValueError, match=r"paired egos \[2\] and partners \[3\] differ in number"):
        job_of(robots(-0.5, 0.5), humans(0.1, 0.2, 0.3), paired=True)


def test_random_actions_are_uniform_functions_of_observations():
    policy = ReferencePolicy(ReferenceSpec("robot", 5, 3))
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(4000, 5)).astype(np.float32))
    first = jnp.zeros(len(obs), bool)
    _, actions = policy.act({"amplitude": jnp.float32(1.0)}, (), obs, first)
    assert actions.shape == (4000, 3)
    np.testing.assert_allclose(
        np.quantile(actions, [0.0, 0.25, 0.5, 0.75, 1.0]), [-1, -0.5, 0, 0.5, 1], atol=0.03
    )
    assert np.abs(np.corrcoef(np.asarray(actions).T) - np.eye(3)).max() < 0.06
    _, some = policy.act({"amplitude": jnp.float32(1.0)}, (), obs[7:9], first[:2])
    np.testing.assert_array_equal(some, actions[7:9])
    _, none = policy.act({"amplitude": jnp.float32(0.0)}, (), obs, first)
    assert not none.any()


def counts(played: pl.DataFrame) -> dict[str, int]:
    return dict(played.group_by(COLUMN).len().rows())


def test_references_are_played_once_for_all_policies(tmp_path: Path):
    own = robots(-0.5, 0.5), humans(-0.5, 0.5)
    seen: list[str] = []

    def note(state: Progress) -> None:
        seen.append(f"{state.what} {state.total}")

    def play(robot: float) -> tuple[pl.DataFrame, Any]:
        seen.clear()
        job = job_of(robots(robot), humans(-0.5, 0.5))
        return play_references(MatrixGame(), job, own, tmp_path, on_progress=note)

    together, files = play(0.3)
    assert counts(together) == {SELF_PLAY: 6, RANDOM: 6, ZERO: 6}
    assert set(seen) == {"reference robots 48", "partners with their own robots 24"}
    again, same = play(-0.9)
    assert again.equals(together) and same == files and all(path.is_file() for path in files)
    assert set(seen) == {"reference robots 0", "partners with their own robots 0"}


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A script of the matrix game, which plays row 1."""
    monkeypatch.setattr("evaluation.play.baselines.SCRIPTS", {"matrix": Script(lambda *_: None)})
    monkeypatch.setattr("evaluation.cast.baseline_policies.build_model", lambda task: None)
    monkeypatch.setattr(
        "evaluation.cast.baseline_policies.script_of",
        lambda task, model: lambda obs: jnp.ones((len(obs), ROBOT.action_size)),
    )


def test_the_script_and_a_passive_human_are_played(tmp_path: Path, scripted: None):
    partners = humans(-0.5, 0.5)
    job = job_of(robots(0.3, -0.3), partners, sides=dict.fromkeys(partners.ids, "test"))
    played, _ = play_references(MatrixGame(), job, (robots(-0.5, 0.5), partners), tmp_path)
    # The script and both robots play with the passive human.
    assert counts(played) == {PASSIVE: 9, SCRIPT: 6, SELF_PLAY: 6, RANDOM: 6, ZERO: 6}
    table = run_job(MatrixGame(), job, tmp_path / "job").table
    shown, _ = summarise_references(recorded(table), played, bounds_table(played))
    pairs = {pair: rows for pair, rows in played.group_by("ego", "partner")}
    paid = {pair: float(rows["term_payoff"].mean()) for pair, rows in pairs.items()}
    steps = int(played["steps"][0])
    assert paid[SCRIPT, partners.ids[0]] == pytest.approx(steps * PAYOFF[1, 0])
    assert paid[SCRIPT, partners.ids[1]] == pytest.approx(steps * PAYOFF[1, 1])
    # An action of 0 is column 0.
    assert paid[SCRIPT, PASSIVE] == pytest.approx(steps * PAYOFF[1, 0])
    assert paid[job.egos.ids[1], PASSIVE] == pytest.approx(steps * PAYOFF[0, 0])
    means = {pair: float(rows["return"].mean()) for pair, rows in pairs.items()}
    assert shown.script and shown.passive_human and shown.script_with_passive_human
    with_script = [means[SCRIPT, human] for human in partners.ids]
    assert shown.script.mean == pytest.approx(np.mean(with_script))
    assert shown.passive_human.n == 2
    with_passive = [means[robot, PASSIVE] for robot in job.egos.ids]
    assert shown.passive_human.mean == pytest.approx(np.mean(with_passive))
    assert shown.script_with_passive_human.mean == pytest.approx(means[SCRIPT, PASSIVE])


def test_outside_robot_meets_passive_human(tmp_path: Path, scripted: None):
    beyond = host(lambda obs: np.full((len(obs), ROBOT.action_size), 2.0, np.float32))
    job = job_of(beyond, humans(-0.5, 0.5))
    assert "clipped" in run_job(MatrixGame(), job, tmp_path / "job").table.columns
    played, _ = play_references(MatrixGame(), job, None, tmp_path)
    assert counts(played) == {PASSIVE: 6, SCRIPT: 6, RANDOM: 6, ZERO: 6}
    assert "clipped" not in played.columns


def test_task_script_is_a_policy():
    """One row at a time or many, of a stack of one: the same actions, in the torque limits."""
    roster = script_roster("gentle_scratch", 47, 7)
    [stack] = roster.stacks
    assert isinstance(stack, PolicyStack) and isinstance(stack.spec, ScriptSpec)
    policy, obs = ScriptedPolicy(stack.spec), np.random.default_rng(3).normal(size=(2, 5, 47))
    obs = jnp.asarray(obs, jnp.float32)
    _, actions = policy.act(None, (), obs, jnp.zeros(obs.shape[:2], bool))
    _, few = policy.act(None, (), obs[1], jnp.zeros(5, bool))
    assert actions.shape == (2, 5, 7) and float(jnp.abs(actions).max()) <= 1.0
    # Another program, of observations that no scene has: quaternions of any length, say.
    np.testing.assert_allclose(actions[1], few, atol=1e-4)
    assert float(jnp.abs(few).max()) > 0.1


@pytest.mark.parametrize("file", [tables.EPISODES_FILE, "manifest.json"])
def test_kept_references_that_are_damaged_are_played_again(tmp_path: Path, file: str):
    """Halved, they would double every figure relative to them."""
    job = job_of(robots(0.3), humans(-0.5, 0.5))
    first, _ = play_references(MatrixGame(), job, None, tmp_path)
    [path] = tmp_path.glob(f"*/{file}")
    if file == tables.EPISODES_FILE:
        halved = pl.read_parquet(path).with_columns(pl.col("return") / 2)
        path.write_bytes(tables.parquet_bytes(halved))
    else:
        path.write_text(path.read_text().replace("a", "b", 1))
    assert play_references(MatrixGame(), job, None, tmp_path)[0].equals(first)


PARTNERS: list[Team] = teams(4)


def played(low: list[float], own: list[float | None]) -> pl.DataFrame:
    """Two episodes of each reference ego with each partner."""
    returns = np.array(low)[None, :, None] + np.array([-1.0, 1.0])
    zero = episode_table(returns, [ZERO], PARTNERS, ["test"] * 4)
    parts = [zero.with_columns(pl.lit(ZERO).alias("reference"))]
    for i, value in enumerate(own):
        if value is not None:
            own_pair = [PARTNERS[i]], [PARTNERS[i]]
            scored = episode_table(np.full((1, 1, 2), value), *own_pair, ["test"])
            parts.append(scored.with_columns(pl.lit(SELF_PLAY).alias("reference")))
    return pl.concat(parts, how="vertical_relaxed")


def crossplay_pairs() -> pl.DataFrame:
    """Return one pair of the second partner, and one of the first."""
    partners = [team_id(PARTNERS[1]), team_id(PARTNERS[0])]
    return pl.DataFrame(
        {
            "ego": ["best", "weak"],
            "ego_team": pl.Series([None, None], dtype=pl.String),
            "partner": [f"{name}/human" for name in partners],
            "return": [90.0, 20.0],
            "partner_team": partners,
            "episodes": pl.Series([8, 8], dtype=pl.Int64),
        }
    )


def test_bounds_name_source_of_best_robot():
    bounds = bounds_table(played([0, 0, 10, 10], [50, 50, 5, None]), crossplay_pairs())
    assert bounds["low"].to_list() == [0, 0, 10, 10]
    assert bounds["best"].to_list() == [50, 90, 5, None]
    assert bounds["source"].to_list() == [SELF_PLAY, CROSS_PLAY, SELF_PLAY, NONE]
    assert bounds["best_ego"].to_list()[1] == "best"
    assert bounds["best_episodes"].to_list() == [2, 8, 2, None]
    assert bounds["low_episodes"].to_list() == [2] * 4


def test_relative_figures_leave_out_and_name_the_unscorable():
    returns = np.array([[25.0, 90.0, 7.0, 7.0]])[..., None]
    table = episode_table(returns, ["mine"], PARTNERS, ["test"] * 4)
    reference = played([0, 0, 10, 10], [50, 50, 5, None])
    bounds = bounds_table(reference, crossplay_pairs())
    played_by, relative = summarise_references(recorded(table), reference, bounds)
    assert relative.normalised_return and relative.br_prox and relative.regret
    assert relative.coverage and played_by.zero_action
    assert relative.normalised_return.mean == pytest.approx((25 / 50 + 90 / 90) / 2)
    assert relative.br_prox.n == 2
    assert relative.regret.mean == pytest.approx(12.5)
    assert relative.worst_regret == WorstRegret(f"{team_id(PARTNERS[0])}/human", 25.0)
    assert relative.coverage.value == 0.5
    assert relative.unscorable == tuple(f"{team_id(team)}/human" for team in PARTNERS[2:])
    assert relative.bounds == BoundsUsed(ZERO, {CROSS_PLAY: 1, NONE: 1, SELF_PLAY: 2}, 2)
    assert played_by.zero_action.mean == 5.0
    assert played_by.uniform_random is None


def test_references_weigh_groups_as_m_test_does():
    partners = [("spring", "own", 0), ("stepper", "own", 1), *PARTNERS[:2]]
    table = episode_table(np.ones((1, 4, 1)), ["mine"], partners, ["test"] * 4)
    low = {"spring": 9.0, "stepper": 3.0, PARTNERS[0][0]: 0.0}
    names = table.select("partner", "partner_algorithm").rows()
    rows = [
        {"partner": name, "reference": ZERO, "ego": ZERO, "return": low[algorithm], "episode": 0}
        for name, algorithm in reversed(names)
    ]
    reference = pl.DataFrame(rows)
    shown, _ = summarise_references(recorded(table), reference, bounds_table(reference))
    assert shown.zero_action is not None and shown.zero_action.mean == pytest.approx(12 / 3)


def test_without_any_scorable_partner_there_is_no_figure():
    table = episode_table(np.ones((1, 4, 1)), ["mine"], PARTNERS, ["test"] * 4)
    reference = played([10] * 4, [None] * 4)
    relative = summarise_references(recorded(table), reference, bounds_table(reference))[1]
    assert relative.br_prox is relative.coverage is relative.regret is relative.worst_regret is None
    assert len(relative.unscorable) == 4
