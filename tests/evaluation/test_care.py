"""Care from the played episode to tables, figures and pages."""

import dataclasses
from collections import namedtuple
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

from assistax_base.extensions import Extension
from assistax_envs.tasks import care
from assistax_zoo.comparing import compare
from assistax_zoo.shell.main import run
from evaluation.figures.bootstrap import estimate
from evaluation.figures.league import league_table, read_league
from evaluation.figures.metrics.caring import care_figures, compare_care, persons_done
from evaluation.figures.metrics.installed import InstalledMetric, Metric
from evaluation.figures.saved_tables import save_evaluation
from evaluation.figures.summary import read_summary, summarise_evaluation
from evaluation.play.evaluator import run_job
from evaluation.play.jobs import Job
from evaluation.plots.figures import adaptation_of
from evaluation.record import tables
from evaluation.record.columns import CARE, TOUCH, VIOLATIONS, validate_episodes, wishes_of
from evaluation.record.record import Record, Returns, lay_out
from evaluation.report.page import write_report
from tests.evaluation.episode_tables import CONTEXT, episode_table, recorded, teams
from tests.evaluation.matrix_game import MatrixGame, Measures, humans, robots

GENTLE = dataclasses.replace(CONTEXT, task="gentle_bath", env_version=4)
PERSONS = 24
SIDE_BY_SIDE = ["test"] * PERSONS

Felt = namedtuple(
    "Felt", (*Measures._fields, "violation", "done", "liked", "judged", "felt", "discomfort")
)


class Bathed(MatrixGame):
    """Persons like 4 N times their strength, and 5 cm/s; robots do 6 N, and the speed of a turn.

    Speed is judged in the first step alone. Whom the robot's row 0 touches is hurt in step 3.
    """

    def reset(self, keys: Any, params: Any) -> Any:
        state = super().reset(keys, params)
        return state._replace(measures=self._felt(state, jnp.zeros(keys.shape[0], bool)))

    def step(self, state: Any, actions: Any) -> Any:
        after = super().step(state, actions)
        hurt = (actions["robot"][:, 0] < 0) & (after.step == 3)
        measures = self._felt(after, hurt)
        return after._replace(measures=measures, terminated=hurt)

    @staticmethod
    def _felt(state: Any, hurt: Any) -> Any:
        one = jnp.ones_like(state.reward)
        liked = jnp.stack([4.0 * state.params.strength, 0.05 * one], axis=-1)
        done = jnp.stack([6.0 * one, 0.1 * one], axis=-1)
        judged = jnp.stack([state.step > 0, state.step == 1], axis=-1)
        kind = jnp.where(hurt, care.PRESSED, care.NONE)
        success = (state.step >= 2) & ~hurt
        uneasy = jnp.where(state.step == 1, 0.5, 0.0)
        mine = (kind, done, liked, judged, state.step > 0, uneasy)
        measures = state.measures._replace(success=success, contact=one, violated=hurt)
        return Felt(*measures, *mine)


def _played(folder: Path, monkeypatch: pytest.MonkeyPatch) -> pl.DataFrame:
    monkeypatch.setattr("population.play.caring.LATE", 1)
    partners = humans(-0.5, 0.5, 0.5, disabilities=("d1", "d9", "d1"))
    sides = dict.fromkeys(partners.ids, "test")
    job = Job("gentle_bath", 4, "native", robots(-0.5, 0.5), partners, sides=sides, episodes=2)
    return run_job(Bathed(task="gentle_bath"), job, folder).table


def test_columns_of_care_reach_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = _played(tmp_path, monkeypatch)
    validate_episodes(table)
    assert wishes_of(table) == ("force", "speed")
    hurt = table.filter(pl.col("violated"))
    assert set(hurt["violation"]) == {"pressed"} and not hurt["success"].any()
    calm = table.filter(~pl.col("violated"))
    assert set(calm["violation"]) == {"none"} and calm["success"].all()
    np.testing.assert_allclose(table["done_force"], 6.0, rtol=1e-6)
    strong = table.filter(partner_disability="d1")
    np.testing.assert_allclose(strong["liked_force"], 4.0)
    assert set(strong["within_force"]) == {1.0}
    weak = table.filter(partner_disability="d9")
    assert set(weak["within_force"]) == {0.0}
    assert table["done_speed"].null_count() == table["within_speed"].null_count() == table.height
    np.testing.assert_allclose(calm["discomfort_share"], 1 / 4)
    np.testing.assert_allclose(hurt["discomfort_share"], 1 / 3)
    tables.write_episodes(table, tmp_path / "again.parquet")
    assert tables.read_episodes(tmp_path / "again.parquet").equals(table)
    with pytest.raises(ValueError, match="column violation holds 'hit'; allowed are 'none'"):
        validate_episodes(table.with_columns(violation=pl.lit("hit")))


def test_kinds_of_violations_are_named_by_their_numbers() -> None:
    named = {kind: getattr(care, kind.upper()) for kind in VIOLATIONS}
    assert list(named.values()) == [0, 1, 2]


def cared(
    seed: int, *, slope: float = 0.6, within: float = 0.8, caring: float = 0.9, seeds: int = 2
) -> pl.DataFrame:
    """Return episodes of robots with persons, of whom the first is failed by all of them."""
    rng = np.random.default_rng(seed)
    shape = seeds, PERSONS, 4
    names = [f"robot-{seed}-{place}" for place in range(seeds)]
    table = episode_table(rng.normal(100, 10, shape), names, teams(PERSONS), SIDE_BY_SIDE)
    liked = np.exp(np.random.default_rng(0).normal(1.3, 0.5, PERSONS))[None, :, None]
    done = np.exp(0.4 + slope * np.log(liked) + rng.normal(0, 0.1, shape))
    success = rng.random(shape) < caring
    success[:, 0] = False
    kinds = np.where(success, "none", np.where(rng.random(shape) < 0.5, "impact", "pressed"))
    return table.with_columns(
        success=success.ravel(),
        violated=(kinds != "none").ravel(),
        contact_peak=pl.lit(3.0),
        liked_force=np.broadcast_to(liked, shape).ravel(),
        done_force=done.ravel(),
        within_force=np.full(done.size, within),
        discomfort_share=rng.uniform(0.0, 0.4, done.size),
        violation=kinds.ravel(),
    )


def test_figures_of_care_are_those_of_the_table() -> None:
    table = cared(1)
    figures = care_figures(lay_out(table))
    assert figures.caring_success and figures.violations and figures.discomfort
    assert figures.caring_success.mean == pytest.approx(table["success"].mean())
    assert figures.discomfort.mean == pytest.approx(table["discomfort_share"].mean())
    for kind, figure in figures.violations_by_kind.items():
        assert figure.mean == pytest.approx((table["violation"] == kind).mean())
    assert list(figures.violations_by_kind) == ["impact", "pressed"]
    shares = table.group_by("ego", "partner").agg(pl.col("success").mean())["success"]
    assert figures.failed_persons
    assert figures.failed_persons.mean == pytest.approx((shares < 0.5).mean()) and min(shares) == 0
    assert list(figures.adaptation) == ["force"]
    assert figures.adaptation["force"].slope.value == pytest.approx(0.6, abs=0.06)
    assert figures.adaptation["force"].credited == 2


def beside_teams(shares: np.ndarray) -> pl.DataFrame:
    """Two robots with a person of either group, then two teams.

    `shares` [4] of the two episodes of a pair are cared for; the others are violated, with twice
    the discomfort and touch.
    """
    partners = [("spring", "own", 0), ("stepper", "own", 1), *teams(2)]
    success = np.stack([shares > 0, shares > 0.5], axis=1)[None].repeat(2, axis=0)
    flat = success.ravel()
    table = episode_table(np.where(success, 100.0, 0.0), teams(2), partners, ["test"] * 4)
    whose = pl.when(pl.col("partner_disability") == "own").then(pl.lit("own"))
    return table.with_columns(
        success=flat,
        violated=~flat,
        violation=pl.Series(np.where(flat, "none", "impact")),
        contact_peak=pl.lit(3.0),
        **dict.fromkeys(TOUCH, pl.Series(np.where(flat, 1.0, 2.0))),
        liked_force=pl.lit(1.0),
        done_force=pl.lit(1.0),
        within_force=pl.lit(1.0),
        discomfort_share=np.where(flat, 0.1, 0.2),
        preference=whose.otherwise(pl.lit("p1")),
    )


def test_teams_beside_persons_are_one_group_of_three() -> None:
    """Known 1, unseen 1/2, teams 0 and 1/2: 7/12 are cared for, and 1/2 of all episodes."""
    table, metric = beside_teams(np.array([1.0, 0.5, 0.0, 0.5])), Metric("caring", caring_of)
    more = {"again": InstalledMetric(metric, Extension("metrics", "again", "a:b", "package", "1"))}
    figures = summarise_evaluation(recorded(table), GENTLE, more)
    assert figures.m_test and figures.m_test.mean == pytest.approx(700 / 12)
    assert figures.caring_success and figures.caring_success.mean == pytest.approx(7 / 12)
    assert figures.caring_success.mean_ci == pytest.approx(
        [end / 100 for end in figures.m_test.mean_ci or ()]
    )
    assert figures.violations and figures.violations.mean == pytest.approx(5 / 12)
    kinds = {kind: figure.mean for kind, figure in figures.violations_by_kind.items()}
    assert kinds == pytest.approx({"impact": 5 / 12, "pressed": 0.0})
    assert figures.discomfort and figures.discomfort.mean == pytest.approx(0.1 + 0.1 * 5 / 12)
    assert [touch.mean for touch in figures.touch.values()] == pytest.approx(
        [1 + 5 / 12] * len(TOUCH)
    )
    assert figures.more["again"].mean == pytest.approx(7 / 12)
    assert figures.failed_persons and figures.failed_persons.n == 4, "of two robots and persons"
    # Each setting, algorithm and preference has its own mean, in which no group stands for another.
    shares = {name: figure.mean for name, figure in figures.by_disability.items()}
    assert shares == pytest.approx({"own": 75.0, "d1": 25.0})
    assert figures.by_preference["p1"].mean == pytest.approx(25.0)
    alone = table.filter(pl.col("partner_disability") != "own")
    found = care_figures(lay_out(alone)).caring_success
    assert found and found == estimate(lay_out(alone).caring, common_starts=True)


def caring_of(returns: Returns) -> np.ndarray:
    return returns.column("success")


def test_care_is_compared_by_groups() -> None:
    tables_ = [beside_teams(np.array(shares)) for shares in ([1, 0.5, 0, 0.5], [0, 0.5, 1, 0.5])]
    found = compare_care(*map(lay_out, tables_)).care
    assert found["caring_success"].mean == pytest.approx((7 - 5) / 12)
    assert found["violations"].mean == pytest.approx((5 - 7) / 12)
    assert found["discomfort"].mean == pytest.approx(0.1 * (5 - 7) / 12)


def test_older_tables_have_violations_alone() -> None:
    """What they call success is no caring success."""
    older = cared(2).drop(name for name in CARE if name in cared(2).columns)
    figures = care_figures(lay_out(older))
    assert figures.violations and figures.caring_success is None and figures.adaptation == {}


def saved(folder: Path, **options: Any) -> Path:
    folder.mkdir(parents=True)
    table = cared(**options)
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    summary = save_evaluation(Record(table, folder), GENTLE)
    assert read_summary(folder) == summary
    return folder


def test_pages_leagues_and_comparisons_show_care(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    league = tmp_path / "league"
    rows = {"gru": {"seed": 3}, "ppo": {"seed": 4, "within": 0.5, "caring": 0.3}}
    folders = {name: saved(league / name, **options) for name, options in rows.items()}
    write_report(folders["gru"], tmp_path / "gru.html")
    text = (tmp_path / "gru.html").read_text()
    assert "caring success" in text and "persons that were failed" in text
    assert "adaptation slope" in text and "by what pressed" in text and "by what struck" in text
    table = league_table(read_league(league))
    by_row = {row["row"]: row for row in table.iter_rows(named=True)}
    assert by_row["gru"]["slope_force"] == pytest.approx(0.6, abs=0.06)
    assert by_row["gru"]["slope_force_low"] < 0.6 < by_row["gru"]["slope_force_high"] + 0.06
    assert by_row["ppo"]["slope_force"] == 0.0  # half of its touch alone is near
    assert by_row["ppo"]["failed_persons"] > 0.5 > by_row["gru"]["failed_persons"] > 0.0
    assert by_row["ppo"]["violations_impact"] + by_row["ppo"]["violations_pressed"] == (
        pytest.approx(by_row["ppo"]["violations"])
    )
    write_report(league, tmp_path / "league.html")
    assert "caring success" in (tmp_path / "league.html").read_text()
    compared = compare(folders["gru"], folders["ppo"])
    assert compared.care["caring_success"].mean > 0.4 > 0 > compared.care["violations"].mean
    first, second = compared.slopes["force"]
    assert first and second and first.value > 0.5 and second.value == 0.0
    assert run(["compare", *map(str, folders.values())]) == 0
    assert "adaptation slope, force: 0." in capsys.readouterr().out


def test_figure_has_a_point_for_each_person_and_a_panel_for_each_wish(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = saved(tmp_path / "gru", seed=5), tmp_path / "adaptation.png"
    assert run(["plot", "adaptation", str(folder), "--out", str(out)]) == 0
    assert out.stat().st_size > 10_000 and capsys.readouterr().out == f"{out}\n"
    [axes] = adaptation_of(folder).axes
    points = np.concatenate([c.get_offsets() for c in axes.collections if len(c.get_offsets()) > 1])
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    one = table.filter(partner=table["partner"][0])
    done = np.exp(np.log(one["done_force"].to_numpy()).mean())
    assert len(points) == PERSONS
    assert np.isclose(points, [one["liked_force"][0], done], rtol=1e-5).all(axis=1).any()
    assert axes.get_title(loc="left").startswith("force: slope 0.")
    idle = table.with_columns(done_force=pl.lit(None, pl.Float32))
    with pytest.raises(ValueError, match="no person was touched late in an episode"):
        persons_done(lay_out(idle))
    older = table.drop(name for name in CARE if name in table.columns)
    with pytest.raises(ValueError, match="do not measure what was done of a wish"):
        persons_done(lay_out(older))


def test_summary_of_another_task_has_no_care() -> None:
    returns = np.random.default_rng(0).normal(size=(1, 6, 2))
    summary = summarise_evaluation(
        recorded(episode_table(returns, ["own"], teams(6), ["test"] * 6)), CONTEXT
    )
    assert summary.violations is None and summary.caring_success is None
