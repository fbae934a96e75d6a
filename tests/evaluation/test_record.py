"""The record of a run: laid out once, whatever is drawn from it."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from evaluation.figures.saved_tables import partner_table, profile_table
from evaluation.figures.summary import summarise_evaluation
from evaluation.play.how import PlaySettings
from evaluation.record import record as records
from evaluation.record.columns import COLUMNS, validate_episodes
from evaluation.record.record import lay_out
from tests.attack.commands import small_zoo
from tests.evaluation.episode_tables import CONTEXT, episode_table, recorded, team_id, teams
from tests.evaluation.test_sources import toy
from tests.studies import cross_play, evaluate_policies
from zoo.registry import load_registry

SETTINGS = PlaySettings("scratch", 2, backend="native")


@pytest.fixture
def layouts(monkeypatch: pytest.MonkeyPatch) -> list[pl.DataFrame]:
    """Every table that was laid out since the test began."""
    tables: list[pl.DataFrame] = []

    def counted(table: pl.DataFrame) -> Any:
        tables.append(table)
        return lay_out(table)

    monkeypatch.setattr(records, "lay_out", counted)
    monkeypatch.setattr("assistax_envs.make", toy)
    monkeypatch.setattr("evaluation.play.baselines.SCRIPTS", {})  # they read true observations
    return tables


@pytest.mark.slow
def test_studies_lay_out_table_once(layouts: list[pl.DataFrame], tmp_path: Path) -> None:
    """Though a partner is left out of the figures, and references and bounds are drawn as well."""
    registry = load_registry(small_zoo(tmp_path / "zoo"))
    robots = ["zoo:scratch/ippo-d1-s0-v0/robot"]
    cross_play(registry, "scratch/*", "scratch/*", SETTINGS, tmp_path / "matrix")
    assert len(layouts) == 1
    options = {"references": tmp_path / "kept", "crossplay": tmp_path / "matrix"}
    summary = evaluate_policies(registry, robots, SETTINGS, tmp_path / "out", **options)
    assert len(layouts) == 2 and layouts[1].height > summary.episodes


def test_record_lays_out_lazily_and_once(layouts: list[pl.DataFrame]) -> None:
    returns = np.random.default_rng(0).normal(size=(2, 6, 3))
    record = recorded(episode_table(returns, ["mine", "other"], teams(6), ["test"] * 6))
    assert not layouts
    for _ in range(2):
        summarise_evaluation(record, CONTEXT)
        partner_table(record)
        profile_table(record.without([f"{team_id(team)}/human" for team in teams(2)]))
    assert len(layouts) == 1


def test_record_without_partners_keeps_other_episodes() -> None:
    """The arrays are selected, and equal to those of a table that never had the others."""
    partners = teams(5, ("ippo", "mappo"))
    table = episode_table(
        np.random.default_rng(1).normal(size=(2, 5, 3)), teams(2), partners, ["test"] * 5
    )
    # One partner's egos met different starts: without it all starts are common again.
    strange = f"{team_id(partners[1])}/human"
    other = (pl.col("partner") == strange) & (pl.col("ego_seed") == 1)
    table = table.with_columns(key=pl.when(other).then(7).otherwise("key"))
    record = recorded(table)
    assert record.returns.keys is None
    rest = record.without([strange])
    expected = lay_out(table.filter(pl.col("partner") != strange))
    assert rest.returns.partners.equals(expected.partners)
    np.testing.assert_array_equal(rest.returns.values, expected.values)
    np.testing.assert_array_equal(rest.returns.keys, expected.keys)
    assert rest.returns.common_starts and expected.common_starts
    assert record.without([]) is record


def test_only_column_families_may_be_missing() -> None:
    table = episode_table(np.ones((2, 3, 2)), teams(2), teams(3))
    for name, column in COLUMNS.items():
        if name not in table.columns:
            assert column.family is not None, name
        elif column.family is None:
            with pytest.raises(ValueError, match=f"lacks the columns {name}"):
                validate_episodes(table.drop(name))
        else:
            validate_episodes(table.drop(name))
