"""A league: its rows in order, the share of the range, the page and the figures."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from assistax_zoo.shell.main import run
from evaluation.figures.league import FIRST, LAST, league_table, ordered, read_league, row_folders
from evaluation.figures.metrics.bounds import best_of_robots, share_of_range
from evaluation.figures.normalised import COLUMN, RANDOM, SCRIPT, ZERO
from evaluation.figures.saved_tables import save_evaluation
from evaluation.figures.summary import Context, EvaluationSummary, SplitName, read_summary
from evaluation.plots.league import league_chart
from evaluation.record import tables
from evaluation.record.record import Record
from population.method_presets import METHODS
from tests.evaluation.episode_tables import CONTEXT, Team, episode_table, sealed, teams
from tests.evaluation.test_contrasts import NAMED
from tools.league.figures import failure_chart, failures, validation_curves
from zoo.partners.person_ids import OWN

PARTNERS = 10
CURVE = pl.DataFrame({"seed": [0, 0], "steps": [10, 20], "return": [1.0, 2.0]})


def played(
    means: np.ndarray, names: list[str], seed: int, partners: list[Team] | None = None
) -> pl.DataFrame:
    """Return the table of robots by partners with these means [S, P], in four episodes."""
    noise = np.random.default_rng(seed).normal(0, 5, (*means.shape, 4))
    table = episode_table(means[..., None] + noise, names, partners or teams(means.shape[1]), None)
    return table.with_columns(pl.lit("test").alias("side"))


def put(
    root: Path,
    row: str,
    means: np.ndarray,
    *,
    baselines: bool = False,
    partners: list[Team] | None = None,
    context: Context = CONTEXT,
) -> Path:
    """Write a row's folder, and return it; partners are networks unless given."""
    names = [f"{row}-{place}" for place in range(len(means))]
    table, folder = played(means, names, len(row), partners), root / row
    if context.split and context.split.groups:  # teams have drawn preferences
        own = pl.col("partner_disability") == OWN
        wish = pl.when(own).then(pl.lit(OWN)).otherwise(pl.lit("p1")).alias("preference")
        table = table.with_columns(wish)
    references = None
    if baselines:
        levels = {ZERO: 10.0, RANDOM: 20.0, SCRIPT: 100.0}
        shape = 1, means.shape[1]
        episodes = pl.concat(
            played(np.full(shape, level), [name], 1, partners).with_columns(
                pl.lit(name).alias(COLUMN)
            )
            for name, level in levels.items()
        )
        columns = {"low": 10.0, "low_episodes": 4, "best": 400.0, "source": "self-play"}
        ids = episodes["partner"].unique(maintain_order=True)
        bounds = pl.DataFrame({"partner": ids, **columns})
        references = episodes, bounds
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    save_evaluation(Record(table, folder), context, references=references)
    return folder


PERSONS = [("spring", "own", place) for place in range(6)]
PERSONS += [("stepper", "own", place) for place in range(3)]
BOTH = [*PERSONS, *teams(2)]
MIXED, ALONE = (
    dataclasses.replace(CONTEXT, split=SplitName(f"persons-s0-v0-{digit * 8}", digit * 64, {}, who))
    for digit, who in (("1", ("known families", "unseen family", "teams")), ("2", ()))
)


def put_beside_teams(root: Path, *, alone: Context = ALONE) -> None:
    """Write rows with persons and teams, and those that play the persons alone."""
    earned = np.repeat([100.0, 200.0, 600.0], (6, 3, 2))
    for row, more in (("ppo", 0.0), ("gru", 30.0)):
        means = np.tile(earned + more, (4, 1))
        put(root, row, means, baselines=row == "ppo", partners=BOTH, context=MIXED)
    means = np.tile(earned[:9] + 50, (4, 1))
    put(root, "mirror", means, partners=PERSONS, context=alone)
    best = np.where(np.eye(9), 500.0, 50.0)
    put(root, "told-best-response", best, partners=PERSONS, context=alone)


@pytest.fixture(scope="module")
def league(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """PPO at 200, GRU at 300; the told best responses of six partners at 500, others' at 50."""
    root = tmp_path_factory.mktemp("league")
    put(root, "ppo", np.full((4, PARTNERS), 200.0), baselines=True)
    put(root, "gru", np.full((4, PARTNERS), 300.0))
    put(root, "told-best-response", np.where(np.eye(6), 500.0, 50.0))
    return root


def test_rows_stand_in_the_leagues_order() -> None:
    names = ["told-best-response", "sac", "ppo", "script", "gru", "zero-action", "mirror"]
    expected = ["zero-action", "script", "ppo", "gru", "sac", "mirror", "told-best-response"]
    assert ordered(names) == expected
    assert not set(FIRST) & set(LAST)


def test_a_league_reads_rows_references_and_shares(league: Path) -> None:
    assert list(row_folders(league)) == ["ppo", "gru", "told-best-response"]
    found = read_league(league)
    by_name = {row.row: row for row in found.rows}
    assert list(by_name) == [ZERO, RANDOM, SCRIPT, "ppo", "gru", "told-best-response"]
    assert by_name["told-best-response"].mean.mean == pytest.approx(500, abs=5)
    assert by_name["told-best-response"].partners == 6
    for row, share in (("ppo", 0.25), ("gru", 0.5), (SCRIPT, 0.0), ("told-best-response", 1.0)):
        figure = by_name[row].share
        assert figure is not None and figure.value_ci is not None
        assert figure.value == pytest.approx(share, abs=0.02)
        assert figure.value_ci[0] - 1e-9 <= figure.value <= figure.value_ci[1] + 1e-9
    assert (by_name["ppo"].robots, by_name["ppo"].mean.n) == (4, 40)
    table = league_table(found)
    assert table["row"].to_list() == list(by_name) and table["share"].null_count() == 0
    assert any("fewer than 16 robots: ppo, gru, told-best-response" in n for n in found.notes)


def test_groups_of_partners_count_alike_and_have_columns(tmp_path: Path) -> None:
    put_beside_teams(tmp_path)
    found = read_league(tmp_path)
    table = {line["row"]: line for line in league_table(found).iter_rows(named=True)}
    expected = {
        "ppo": (11, 300, 100, 200, 600),
        "gru": (11, 330, 130, 230, 630),
        SCRIPT: (11, 100, 100, 100, 100),
        "mirror": (9, 200, 150, 250, None),
        "told-best-response": (9, 500, 500, 500, None),
    }
    for row, figures in expected.items():
        names = ("partners", "mean", "known_families", "unseen_family", "teams")
        values = [table[row][name] for name in names]
        assert values == pytest.approx(list(figures), abs=6), row
    for group in ("known_families", "unseen_family", "teams"):
        line = table["ppo"]
        assert line[f"{group}_low"] <= line[group] <= line[f"{group}_high"]
    summary = read_summary(tmp_path / "ppo")
    assert isinstance(summary, EvaluationSummary) and summary.m_test
    [ppo] = [row for row in found.rows if row.row == "ppo"]
    assert list(ppo.by_group) == list(summary.by_group)
    said = (summary.m_test, *summary.by_group.values())
    for figure, own in zip((ppo.mean, *ppo.by_group.values()), said, strict=True):
        assert figure.mean_ci == pytest.approx(own.mean_ci, rel=1e-4)
    notes = [note for note in found.notes if note.startswith("with persons alone")]
    assert [note.partition(";")[0] for note in notes] == [
        "with persons alone: mirror, told-best-response"
    ]
    assert not any("in common" in note and "compared on" in note for note in found.notes)


def test_rows_of_persons_may_play_their_split_and_others_may_not(tmp_path: Path) -> None:
    put_beside_teams(tmp_path)
    turns = {"ppo": ["p1", "p2"], "gru": ["p1", "p2"], "mirror": None}
    for row, preferences in turns.items():
        sealed(tmp_path / row, preferences=preferences)
    assert "mirror" in [row.row for row in read_league(tmp_path).rows]
    sealed(tmp_path / "mirror", stochastic=True)
    with pytest.raises(ValueError, match=r"stochastic is false in .* and true in mirror"):
        read_league(tmp_path)
    sealed(tmp_path / "mirror")
    sealed(tmp_path / "gru")
    with pytest.raises(ValueError, match=r"preferences is \[.* in ppo and none in gru"):
        read_league(tmp_path)
    shutil.rmtree(tmp_path / "gru")
    put(tmp_path, "gru", np.full((4, 9), 100.0), partners=PERSONS, context=ALONE)
    with pytest.raises(ValueError, match=r"split is persons-s0-v0-1* in ppo and .*-2* in gru"):
        read_league(tmp_path)


def test_a_league_of_two_releases_is_refused(league: Path, tmp_path: Path) -> None:
    place = shutil.copytree(league, tmp_path / "other") / "gru"
    summary = tables.read_json(place / tables.SUMMARY_FILE)
    tables.write_json({**summary, "release": "v1"}, place / tables.SUMMARY_FILE)
    with pytest.raises(ValueError, match="release is v0 in ppo and v1 in gru"):
        read_league(tmp_path / "other")
    with pytest.raises(FileNotFoundError, match="no finished evaluation in a folder"):
        read_league(tmp_path)


def test_share_of_a_range_by_hand() -> None:
    low, scores = np.array([1.0, 3.0]), np.array([[2.0, 6.0], [4.0, 8.0]])
    share = share_of_range(scores, low, np.array([5.0, 11.0]))
    assert share is not None and share.value == pytest.approx(3.0 / 6.0)
    assert share_of_range(scores, low, low) is None
    # If every robot earns half of the range with each partner, so does every resample.
    rng = np.random.default_rng(2)
    low, high = rng.normal(0, 50, 12), rng.normal(500, 100, 12)
    share = share_of_range(np.tile((low + high) / 2, (5, 1)), low, high)
    assert share is not None and share.value_ci == pytest.approx((0.5, 0.5))


def test_the_interval_of_a_share_covers_it() -> None:
    """Seeds of SD 30, partners' ranges of SD 100: 95% of intervals hold the true share."""
    rng, covered = np.random.default_rng(4), 0
    for _ in range(300):
        high = rng.normal(500, 100, 30)
        scores = 0.4 * high + rng.normal(0, 30, (16, 1)) + rng.normal(0, 40, (16, 30))
        share = share_of_range(scores, np.zeros(30), high)
        assert share is not None and share.value_ci is not None
        covered += share.value_ci[0] <= 0.4 <= share.value_ci[1]
    assert 0.89 < covered / 300 < 0.99


def test_best_robot_is_cross_validated() -> None:
    returns = np.random.default_rng(3).normal(100, 50, (16, 200, 8))
    assert returns.mean(axis=2).max(axis=0).mean() > 120  # the maximum of noise
    assert best_of_robots(returns).mean() == pytest.approx(100, abs=5)
    best = np.where(np.arange(16)[:, None, None] == 3, 300.0, returns)
    assert best_of_robots(best) == pytest.approx(np.full(200, 300.0))
    assert best_of_robots(returns[..., :1]).shape == (200,)


def test_the_page_has_rows_contrasts_and_their_hash(league: Path, tmp_path: Path) -> None:
    file, page = tmp_path / "contrasts.toml", tmp_path / "page.html"
    file.write_text(NAMED)
    words = ["report", str(league), "--out", str(page)]
    assert run(words) == 0
    text = page.read_text()
    assert "League: scratch" in text and "told-best-response" in text and "Contrasts" not in text
    assert run([*words, "--contrasts", str(file)]) == 0
    text = page.read_text()
    assert "gru - ppo" in text and "sha256 <code>" in text
    assert "named and not played, they count as p = 1: sac less ppo" in text


def test_the_page_has_columns_of_groups(tmp_path: Path) -> None:
    put_beside_teams(tmp_path / "league")
    page = tmp_path / "page.html"
    assert run(["report", str(tmp_path / "league"), "--out", str(page)]) == 0
    text = page.read_text()
    assert "unseen family" in text and "with persons alone: mirror" in text


def test_who_fails_with_whom(league: Path) -> None:
    shares = failures(read_league(league).by_partner)
    told = shares.filter(row="told-best-response")
    assert told["share"].to_list() == pytest.approx([1.0] * 6)
    ppo = shares.filter(row="ppo").sort("partner")
    assert not ppo["fails"].any() and ppo["share"].max() == pytest.approx(2 / 3, abs=0.05)
    assert shares.filter(row=ZERO)["fails"].all()


def test_figures_have_a_place_for_every_row(league: Path) -> None:
    found = read_league(league)
    labels = league_chart({"scratch": league_table(found)}).axes[0].get_yticklabels()
    assert [label.get_text() for label in labels] == [row.row for row in found.rows]
    chart = failure_chart({"scratch": failures(found.by_partner)})
    assert len(chart.axes[0].get_yticklabels()) == len(found.rows)
    curves = pl.concat([CURVE, CURVE.with_columns(pl.col("seed") + 1, pl.col("return") + 2)])
    lines = validation_curves({"scratch": {"ppo": curves, "gru": curves}}).axes[0].lines
    assert [list(line.get_ydata()) for line in lines] == [[2.0, 3.0]] * 2


def test_league_rows_have_distinct_styles() -> None:
    known = ["ppo", "sac", *METHODS, *LAST]
    names = ordered([*known, *(f"own-{place}" for place in range(24 - len(known)))])
    lines = validation_curves({"scratch": dict.fromkeys(names, CURVE)}).axes[0].lines
    looks = [(line.get_marker(), line.get_linestyle()) for line in lines]
    assert len(set(looks)) == len(names) == 24


def test_learning_curve_legend_overlaps_no_line() -> None:
    rows = {"scratch": {"ppo": CURVE}, "lift": {"ppo": CURVE, "gru": CURVE}, "bath": {"gru": CURVE}}
    chart = validation_curves(rows)
    chart.draw_without_rendering()
    (legend,) = chart.legends
    assert [text.get_text() for text in legend.get_texts()] == ["ppo", "gru"]
    assert not any(legend.get_window_extent().overlaps(a.get_window_extent()) for a in chart.axes)
    assert chart.bbox.x1 >= legend.get_window_extent().x1
