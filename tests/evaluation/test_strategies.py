import json

import numpy as np
import polars as pl
import pytest

from evaluation.figures.saved_tables import pair_table
from evaluation.figures.strategies import best_responses, summarise_strategies
from evaluation.record.columns import BEHAVIOUR
from tests.evaluation.episode_tables import (
    clustered_matrix,
    episode_table,
    recorded,
    team_id,
    teams,
)

TEAMS = teams(12)


def planted() -> pl.DataFrame:
    """Three groups of partners, t mod 3, that differ in force and in the robot's travel with it."""
    table = episode_table(clustered_matrix(12, 3)[:, :, None], TEAMS, TEAMS)
    group = pl.col("partner_seed") % 3
    noise = pl.Series(np.random.default_rng(0).normal(0, 0.3, table.height))
    behaviour = {"force_mean": 5.0 * group + noise, "robot_travel": 40.0 - 10.0 * group + noise}
    return pair_table(recorded(table.with_columns(**behaviour)))


def group_of(partner: str) -> int:
    return int(partner.split("-s")[1].split("-")[0]) % 3


def test_planted_behaviour_groups_are_found():
    strategies = summarise_strategies(planted())
    assert json.loads(json.dumps(strategies, allow_nan=False)) == strategies
    groups = [{*map(group_of, cluster["members"])} for cluster in strategies["clusters"]]
    assert sorted(groups, key=min) == [{0}, {1}, {2}]
    assert all(cluster["medoid"] in cluster["members"] for cluster in strategies["clusters"])
    assert [len(cluster["members"]) for cluster in strategies["clusters"]] == [4, 4, 4]


def test_a_partner_is_described_with_its_best_robot():
    pairs = planted()
    responses = best_responses(pairs)
    # Self-play is planted highest.
    assert responses.robots == [f"{team_id(team)}/robot" for team in TEAMS]
    own = pairs.filter(pl.col("ego_team") == pl.col("partner_team"))
    np.testing.assert_allclose(responses.features[:, 2], own["force_mean"])
    matrix = clustered_matrix(12, 3)
    np.testing.assert_allclose(responses.returns, matrix, rtol=1e-6)


def test_the_incompatible_two_lose_when_robots_are_exchanged():
    pair = summarise_strategies(planted())["incompatible"]
    assert len(set(map(group_of, pair["partners"]))) == 2
    assert min(pair["returns"]) - 200 > max(pair["returns_exchanged"])


def test_one_robot_for_all_has_no_incompatible_two():
    table = episode_table(np.ones((1, 12, 1)), teams(1), TEAMS)
    strategies = summarise_strategies(pair_table(recorded(table)))
    assert strategies["incompatible"] is None
    assert len(strategies["clusters"]) == 1
    assert strategies["diverse_subset"] == []


def test_table_without_behaviour_error_has_advice():
    with pytest.raises(ValueError, match=r"lacks first_contact.*run the cross-play again"):
        summarise_strategies(planted().drop(BEHAVIOUR))
