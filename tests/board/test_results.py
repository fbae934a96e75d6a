"""What a worker sends is data of a stranger: read, or refused, and the server lives."""

import json
from typing import Any

import polars as pl
import pytest

from assistax_board.problems import Problem
from assistax_board.rules.results import figures
from assistax_board.rules.scoring import GENTLE_COLUMNS, decode_table, encode_table, table_bytes
from assistax_board.service import Service
from assistax_board.work import worker as working
from assistax_board.work.worker import Worker
from tests.board.fakes import FakeScorer, draft, new_submitter, shown
from tests.board.running import served

PARTNERS, EPISODES, LIKES = ("a", "b"), 2, ("p1", "p5")


def rows(**changed: Any) -> dict[str, Any]:
    """Return a whole result of two partners and two episodes, as a worker has it."""
    return {
        "partner": ["a", "a", "b", "b"],
        "algorithm": ["ippo"] * 4,
        "disability": ["d1"] * 4,
        "episode": [0, 1, 0, 1],
        "return": [0.1, 2.0, -3.5, 1e30],
        "success": [True, False, True, False],
        "nonfinite": [False] * 4,
    } | changed


def gentle(**changed: Any) -> dict[str, Any]:
    likes = ["p1", "p5", "p5", "p1"]
    care = {
        "violation": ["none", "impact", "none", "pressed"],
        "discomfort_share": [0.0, 0.5, 1, 0],
    }
    wish = {"liked_force": [2.0] * 4, "done_force": [None, 1.5, 3.0, 4.0]}
    within = {"within_force": [None, 0.25, 1.0, 0.0]}
    violated = [False, True, False, True]
    return rows(preference=likes, violated=violated) | care | wish | within | changed


def test_a_score_is_the_mean_of_the_groups_means() -> None:
    """Three partners of known families and one of the unseen one."""
    families = ["spring", "muscle", "spring", "stepper"]
    table = pl.DataFrame(
        {
            **{"partner": list("abcd"), "algorithm": families, "episode": [0] * 4},
            **{"return": [100.0, 110.0, 90.0, 20.0], "success": [True] * 4},
            "nonfinite": [False] * 4,
        }
    )
    score = figures(table)
    assert score["mean"] == pytest.approx(60.0)
    means = {name: group["mean"] for name, group in score["by_group"].items()}
    assert means == pytest.approx({"known families": 100.0, "unseen family": 20.0})
    teams = figures(table.with_columns(algorithm=pl.lit("ippo")))
    assert teams["mean"] == pytest.approx(80.0) and "by_group" not in teams


@pytest.mark.parametrize(("made", "likes"), [(rows, ()), (gentle, LIKES)])
def test_a_result_arrives_as_it_was_sent(made: Any, likes: tuple[str, ...]) -> None:
    table = pl.DataFrame(made())
    arrived = decode_table(encode_table(table), PARTNERS, EPISODES, likes)
    assert table_bytes(arrived) == table_bytes(table)
    assert arrived["return"].to_list() == table["return"].cast(pl.Float32).to_list()
    assert set(GENTLE_COLUMNS) <= set(arrived.columns) or not likes


@pytest.mark.parametrize(
    ("content", "likes"),
    [
        (rows(episode=["0", "1", "0", "1"]), ()),
        (rows(episode=[0, 1, 0, 2**40]), ()),
        (rows(success=[1, 0, 1, 0]), ()),
        (rows(partner=["a", "a", "b"]), ()),
        (rows(partner=["a", None, "b", "b"]), ()),
        (rows(partner=["a", "a", "b", "c"]), ()),
        (rows(episode=[0, 0, 0, 1]), ()),
        (rows(**{"return": [0.0, 0.0, 0.0, 1e300]}), ()),
        (rows(**{"return": [0.0, 0.0, 0.0, float("nan")]}), ()),
        (rows(weights=[1]), ()),
        (rows(), LIKES),
        (gentle(), ()),
        (gentle(preference=["p1", "p5", "p9", "p1"]), LIKES),
        (gentle(violation=["none", "hit", "none", "none"]), LIKES),
        (gentle(discomfort_share=[0.0, 1.5, 0.0, 0.0]), LIKES),
        (gentle(liked_force=[2.0, 0.0, 2.0, 2.0]), LIKES),
        (gentle(liked_force=[2.0, None, 2.0, 2.0]), LIKES),
        (gentle(done_press=[2.0] * 4), LIKES),
        (gentle(done_force=None), LIKES),
        ([], ()),
        ("[" * 5000, ()),
    ],
)
def test_foreign_result_is_refused(content: Any, likes: tuple[str, ...]) -> None:
    data = content if isinstance(content, str) else json.dumps(content)
    with pytest.raises(Problem, match="result"):
        decode_table(data.encode(), PARTNERS, EPISODES, likes)


def damaged_parquet(table: pl.DataFrame) -> list[bytes]:
    """Return files of which some abort Polars: see `tests.evaluation.test_tables`."""
    whole = table_bytes(table)
    places = [place for place, byte in enumerate(whole) if byte == 24][:8]
    return [whole, *(whole[:at] + bytes([25]) + whole[at + 1 :] for at in places)]


def test_damaged_parquet_ends_neither_server_nor_submission(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    id, scorer = service.submit(new_submitter(service), draft()), FakeScorer()
    with served(service) as server:
        client = server.client("work")
        work = client.lease("w", scorer.versions())
        assert work is not None
        for data in damaged_parquet(scorer.play(work, b"robot 1.0", None)):
            with pytest.raises(Problem, match="a result is JSON"):
                client.result(work, data, 1.0)
        client.give_back(work)
        monkeypatch.setattr(working, "encode_table", lambda table: damaged_parquet(table)[-1])
        done = Worker(client, scorer, idle=0.01)
        # One job, where `run` would go on to the next.
        assert done._do(client.lease("w", scorer.versions())) == 0
        assert shown(service, id).state == "running", "its job is in the queue again"
        monkeypatch.undo()
        assert done.run(until_empty=True) == 3
    assert shown(service, id).state == "scored"
