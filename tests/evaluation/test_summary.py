import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from evaluation.figures import saved_tables as derived
from evaluation.figures import summary
from evaluation.figures.comparable import summarise_comparison
from evaluation.record import tables
from evaluation.record.record import Record
from evaluation.replay.headline import headline_of
from tests.evaluation.episode_tables import (
    CONTEXT,
    clustered_matrix,
    episode_table,
    recorded,
    team_id,
    teams,
)

PARTNERS = teams(12, ("ippo", "isac"), ("d1", "d9"))
SIDES = ["test", "train", "test"] * 4


def evaluation_table(egos: int = 3, k: int = 4) -> pl.DataFrame:
    returns = np.random.default_rng(0).normal(500, 50, (egos, 12, k))
    return episode_table(returns, teams(egos), PARTNERS, SIDES)


def summarised(table: pl.DataFrame) -> dict[str, Any]:
    """Return the summary of an evaluation as it is written."""
    return tables.to_json(summary.summarise_evaluation(recorded(table), CONTEXT))


def test_evaluation_has_the_promised_figures_and_is_json():
    table = evaluation_table()
    figures = summarised(table)
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    means = table.group_by("side").agg(pl.col("return").mean())
    by_side = dict(means.iter_rows())
    assert figures["m_test"]["mean"] == pytest.approx(by_side["test"])
    assert figures["m_train"]["mean"] == pytest.approx(by_side["train"])
    assert figures["gap"]["mean"] == pytest.approx(by_side["train"] - by_side["test"])
    assert (figures["m_test"]["n"], figures["m_train"]["n"]) == (24, 12)
    assert figures["m_test"]["generalises_to"] == "seeds, partners and starts"
    assert figures["common_starts"]
    assert figures["split"] == tables.to_json(CONTEXT.split)
    assert (figures["episodes"], figures["episodes_per_pair"], figures["nonfinite"]) == (144, 4, 0)
    for name in ("release", "env_version", "backend", "env_steps_per_second", "task"):
        assert figures[name] == getattr(CONTEXT, name)


def test_groups_use_test_partners():
    table = evaluation_table()
    figures = summarised(table)
    test = table.filter(side="test")
    for trait in ("algorithm", "disability"):
        means = test.group_by(f"partner_{trait}").agg(pl.col("return").mean())
        found = {name: figure["mean"] for name, figure in figures[f"by_{trait}"].items()}
        assert found == pytest.approx(dict(means.iter_rows()))
    worst = test.group_by("partner").agg(pl.col("return").mean()).sort("return").row(0, named=True)
    assert figures["worst_partner"]["partner"] == worst["partner"]
    assert figures["worst_partner"]["mean"] == pytest.approx(worst["return"])
    assert figures["cvar_10"]["n"] == 24
    assert figures["fairness"]["gap"]["value"] == pytest.approx(
        abs(figures["by_disability"]["d1"]["mean"] - figures["by_disability"]["d9"]["mean"])
    )


def test_teams_beside_persons_are_a_group_of_their_own():
    partners = [("spring", "d1", 0), ("stepper", "d1", 1), *teams(2, ("ippo",))]
    returns = np.random.default_rng(0).normal(500, 50, (3, 4, 2))
    table = episode_table(returns, teams(3), partners, ["test"] * 4)
    found = summary.summarise_evaluation(recorded(table), CONTEXT)
    means = dict(zip(partners, returns.mean(axis=(0, 2)), strict=True))
    expected = {
        "known families": means[partners[0]],
        "unseen family": means[partners[1]],
        "teams": (means[partners[2]] + means[partners[3]]) / 2,
    }
    assert {name: figure.mean for name, figure in found.by_group.items()} == pytest.approx(expected)
    assert found.m_test is not None
    assert found.m_test.mean == pytest.approx(sum(expected.values()) / 3)
    groups = dict(zip(found.by_group, headline_of(found).groups, strict=True))
    played = {name: set(table.filter(rows)["partner_algorithm"]) for name, rows in groups.items()}
    assert played == {
        "known families": {"spring"},
        "unseen family": {"stepper"},
        "teams": {"ippo"},
    }


def test_teams_do_not_stand_for_known_families():
    partners = [("stepper", "d1", 1), *teams(2, ("ippo",))]
    table = episode_table(np.ones((3, 3, 2)), teams(3), partners, ["test"] * 3)
    found = summary.summarise_evaluation(recorded(table), CONTEXT)
    assert (found.m_test, set(found.by_group)) == (None, {"unseen family", "teams"})


def test_split_with_teams_expects_them():
    """So a robot that suits persons alone cannot hide, nor one that suits teams alone."""
    split = summary.SplitName("s", "0" * 64, groups=("known families", "unseen family", "teams"))
    context = dataclasses.replace(CONTEXT, split=split)
    persons = [("spring", "own", 0), ("stepper", "own", 1)]
    for partners, whole in ((persons, False), (teams(2), False), ([*persons, *teams(2)], True)):
        returns = np.random.default_rng(0).normal(500, 50, (3, len(partners), 2))
        record = recorded(episode_table(returns, teams(3), partners, ["test"] * len(partners)))
        found = summary.summarise_evaluation(record, context)
        assert (found.m_test is not None) == whole
        played = {"known families", "unseen family"} if partners is persons else {"teams"}
        assert {*found.by_group} == ({*split.groups} if whole else played)
        assert summary.summarise_evaluation(record, CONTEXT).m_test is not None
        assert tables.to_json(found)["split"]["groups"] == list(split.groups)
    assert "groups" not in tables.to_json(CONTEXT)["split"], "as it was without teams"


def test_groups_count_alike_in_a_comparison():
    partners = [("spring", "own", 0), ("stepper", "own", 1), *teams(4)]
    rng = np.random.default_rng(0)
    records = [
        recorded(episode_table(rng.normal(500, 50, (3, 6, 2)), teams(3), partners, ["test"] * 6))
        for _ in range(2)
    ]
    found = [summary.summarise_evaluation(record, CONTEXT).m_test for record in records]
    difference = summarise_comparison(*records).test
    assert difference is not None and all(found)
    assert difference.means == pytest.approx([figure.mean for figure in found if figure])
    assert difference.mean == pytest.approx(difference.means[0] - difference.means[1])
    plain = np.subtract(*(record.returns.values.mean() for record in records))
    assert abs(difference.mean - plain) > 1.0


def test_own_preferences_are_no_preference():
    partners = [("spring", "own", 0), *teams(2)]
    table = episode_table(np.arange(12.0).reshape(2, 3, 2), teams(2), partners, ["test"] * 3)
    named = pl.when(pl.col("partner_disability") == "own").then(pl.lit("own"))
    table = table.with_columns(named.otherwise(pl.lit("p1")).alias("preference"))
    record = recorded(table.with_columns(violated=False, contact_peak=1.0))
    assert set(summary.summarise_evaluation(record, CONTEXT).by_preference) == {"p1"}
    assert record.returns.with_own_wishes.partners["partner_algorithm"].to_list() == ["spring"]


def test_single_ego_and_episode_are_noted():
    figures = summarised(evaluation_table(egos=1, k=1))
    assert figures["m_test"]["generalises_to"] == "partners"
    assert figures["cvar_10"] is None
    assert figures["worst_partner"]["crossfit"] is None
    assert figures["notes"][0].startswith("one robot: intervals speak about new partners")
    assert any("groups of partners have as few as" in note for note in figures["notes"])


def test_only_training_partners_leave_m_test_empty():
    figures = summarised(evaluation_table().filter(side="train"))
    assert (figures["m_test"], figures["gap"], figures["side"]) == (None, None, "train")
    assert figures["m_train"]["n"] == 12
    with pytest.raises(ValueError, match="evaluate against a split"):
        summarised(evaluation_table().with_columns(side=pl.lit(None, pl.String)))


def test_clipped_actions_are_noted():
    table = evaluation_table()
    shares = pl.Series("clipped", [0.0, 0.5] * (table.height // 2), pl.Float32())
    [note] = [note for note in summarised(table.with_columns(shares))["notes"] if "clip" in note]
    assert note.endswith("were clipped in 72 of 144 episodes: 25.0% of their numbers")
    assert not [note for note in summarised(table)["notes"] if "clip" in note]


def test_nonfinite_episodes_are_counted_and_never_left_out():
    broken = pl.col("episode").eq(0) & pl.col("partner_seed").eq(0)
    earned = pl.when(broken).then(0.0).otherwise("return")
    table = evaluation_table().with_columns(earned.alias("return"), nonfinite=broken)
    figures = summarised(table)
    assert (figures["nonfinite"], figures["episodes"]) == (3, 144)
    assert figures["m_test"]["mean"] == pytest.approx(table.filter(side="test")["return"].mean())
    note = "3 of 144 episodes became non-finite and earn 0 from then on; they count"
    assert note in figures["notes"]
    assert derived.partner_table(recorded(table))["nonfinite"].sum() == 3


def test_outside_egos_are_seeds_of_method():
    returns = np.random.default_rng(0).normal(500, 50, (2, 12, 2))
    table = episode_table(returns, ["a.safetensors", "b.safetensors"], PARTNERS, SIDES)
    figures = summarised(table)
    assert figures["egos"] == ["a.safetensors", "b.safetensors"]
    assert figures["m_test"]["n"] == 16


def test_crossplay_of_the_matrix_game():
    payoff = np.array([[4.0, 1.0], [0.5, 3.0]])
    pair = teams(2)
    record = recorded(episode_table(payoff[:, :, None], pair, pair))
    content = tables.to_json(summary.summarise_crossplay(record, CONTEXT))
    figures = [content[key]["mean"] for key in ("self_play", "cross_play", "gap")]
    assert figures == [3.5, 0.75, 2.75]
    assert content["relative_gap"]["value"] == pytest.approx(2.75 / 3.5)
    assert content["best_ego"] == {"ego": f"{team_id(pair[0])}/robot", "mean": 2.5}
    assert json.loads(json.dumps(content, allow_nan=False)) == content


def test_crossplay_order_keeps_diagonal():
    population = teams(12)
    matrix = clustered_matrix(12, 3)
    shuffled = np.random.default_rng(0).permutation(12)
    table = episode_table(matrix[:, shuffled, None], population, [population[i] for i in shuffled])
    pairs, order = derived.crossplay_matrix(recorded(table))
    assert sorted(order["teams"]["order"]) == sorted(team_id(team) for team in population)
    diagonal = pairs.filter(pl.col("ego_team") == pl.col("partner_team"))["return"].sort()
    np.testing.assert_allclose(diagonal, sorted(np.diag(matrix)), rtol=1e-6)
    assert [len(cluster["members"]) for cluster in order["teams"]["clusters"]] == [4, 4, 4]


def test_other_teams_on_the_axes_share_no_order():
    table = episode_table(np.zeros((2, 3, 1)), teams(2), teams(3))
    _, order = derived.crossplay_matrix(recorded(table))
    assert order["teams"] is None
    assert (len(order["rows"]["order"]), len(order["columns"]["order"])) == (2, 3)
    table = episode_table(np.zeros((1, 20, 1)), teams(1), teams(20))
    notes = summary.summarise_crossplay(recorded(table), CONTEXT).notes
    assert any(note.startswith("1 team: intervals over fewer than 16") for note in notes)


def test_comparison_refuses_other_partners_or_keys():
    table = evaluation_table()
    better = table.with_columns(pl.col("return") + 10.0)
    comparison = summarise_comparison(recorded(better), recorded(table))
    assert comparison.test is not None and comparison.train is not None
    assert comparison.test.mean == pytest.approx(10.0)
    assert (comparison.test.partners_better, comparison.train.partners_better) == (1.0, 1.0)
    counts = table.filter(side="test").select("ego", "partner").n_unique()
    assert comparison.test.seeds == (table["ego"].n_unique(),) * 2
    assert comparison.test.partners * table["ego"].n_unique() == counts
    means = [t.filter(side="test")["return"].mean() for t in (better, table)]
    assert comparison.test.means == pytest.approx(means)
    with pytest.raises(ValueError, match="different partners"):
        summarise_comparison(recorded(better.filter(pl.col("partner_seed") > 0)), recorded(table))
    with pytest.raises(ValueError, match="in different episodes"):
        summarise_comparison(recorded(better.with_columns(pl.col("key") + 1)), recorded(table))


def test_own_starts_are_inside_interval():
    rng = np.random.default_rng(0)
    returns = rng.normal(size=(4, 12, 9)) + 5 * rng.normal(size=9)
    common = episode_table(returns, teams(4), teams(12), ["test"] * 12)
    own = common.with_columns(key=pl.col("key") + 1000 * pl.col("partner_seed"))
    first, second = (
        summary.summarise_evaluation(recorded(table), CONTEXT) for table in (common, own)
    )
    assert first.m_test is not None and second.m_test is not None
    assert first.m_test.mean == second.m_test.mean
    assert second.m_test.generalises_to == "seeds and partners"
    assert first.m_test.mean_ci is not None and second.m_test.mean_ci is not None
    assert np.ptp(first.m_test.mean_ci) > 3 * np.ptp(second.m_test.mean_ci)
    assert any("the same 9 starts" in note for note in first.notes)
    assert not any("starts" in note for note in second.notes)


def test_saved_figures_equal_printed_figures(tmp_path: Path):
    saved = derived.save_evaluation(Record(evaluation_table(), tmp_path / "m"), CONTEXT)
    assert tables.read_json(tmp_path / "m" / tables.SUMMARY_FILE) == tables.to_json(saved)
    partners = tables.read_parquet(tmp_path / "m" / tables.PARTNERS_FILE)
    assert partners.height == 12
    assert (partners["return_low"] < partners["return"]).all()
    profile = tables.read_parquet(tmp_path / "m" / tables.PROFILE_FILE)
    assert (profile["share"][0], profile["share"][-1]) == (1.0, 0.0)
    assert (profile["low"] <= profile["share"]).all()
    population = teams(6)
    table = episode_table(clustered_matrix(6, 2)[:, :, None], population, population)
    saved = derived.save_crossplay(Record(table, tmp_path / "x"), CONTEXT)
    assert tables.read_json(tmp_path / "x" / tables.SUMMARY_FILE) == tables.to_json(saved)
    assert tables.read_parquet(tmp_path / "x" / tables.PAIRS_FILE).height == 36
    assert set(tables.read_json(tmp_path / "x" / tables.ORDER_FILE)) >= {"rows", "columns", "teams"}


def test_training_partners_are_kept_not_counted(tmp_path: Path):
    """Of twelve partners one is the second ego's own: with it, every figure would be another."""
    table = evaluation_table(egos=1)
    own = f"{team_id(PARTNERS[0])}/human"
    table = table.with_columns(
        pl.when(pl.col("partner") == own).then(5000.0).otherwise("return").alias("return")
    )
    saved = derived.save_evaluation(Record(table, tmp_path / "new"), CONTEXT)
    assert saved.m_test is not None and saved.m_test.n == 7
    assert saved.m_test.mean < 1000
    assert saved.partners == {"train": 4, "test": 7}
    assert saved.episodes == 11 * 4
    assert any("left out of the figures" in note and own in note for note in saved.notes)
    kept = tables.read_parquet(tmp_path / "new" / tables.PARTNERS_FILE)
    assert kept.filter(partner=own)["return"].item() == 5000.0
    profile = tables.read_parquet(tmp_path / "new" / tables.PROFILE_FILE)
    assert (profile["threshold"] < 1000).all()
    counted = derived.save_evaluation(Record(table, tmp_path / "own"), CONTEXT, include_own=True)
    assert counted.m_test is not None and counted.m_test.n == 8
    assert counted.m_test.mean > 1000
    assert any("counted all the same" in note and own in note for note in counted.notes)
    alone = table.filter(pl.col("partner") == own)
    with pytest.raises(ValueError, match="let include_own count them"):
        derived.save_evaluation(Record(alone, tmp_path / "none"), CONTEXT)


def test_validation_side_has_own_figure():
    table = evaluation_table(egos=2)
    chosen = table.filter(side="test")["partner"].unique().sort()[:2].implode()
    validated = pl.when(pl.col("partner").is_in(chosen)).then(pl.lit("validation"))
    table = table.with_columns(side=validated.otherwise("side"))
    figures = summary.summarise_evaluation(recorded(table), CONTEXT)
    assert figures.m_validation is not None and figures.m_validation.n == 2 * 2
    assert figures.m_test is not None and figures.side == "test"
    assert figures.partners["validation"] == 2
    alone = recorded(table.filter(side="validation"))
    figures = summary.summarise_evaluation(alone, CONTEXT)
    assert (figures.side, figures.m_test, figures.gap) == ("validation", None, None)
    assert figures.m_validation is not None and figures.variance is not None
