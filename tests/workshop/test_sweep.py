import json
from functools import partial

import polars as pl
import pytest

from assistax_workshop.sweep import Sweep, best, make_sweep, run_sweep, score
from assistax_workshop.sweep_space import SPACES, Range, read_space
from population.hyperparameters import preset
from tests.population.toy_env import ToyEnv, match

FIXED = {"num_envs": 8, "rollout_steps": 10, "hidden": (8, 8), "epochs": 1}
SPACE = {
    "learning_rate": Range(1e-3, 1e-2),
    "gamma": Range(0.8, 0.95, log=False),
    "minibatches": (1, 2),
}


def plan(**changes):
    fields = {"configurations": 5, "seeds": 2, "steps": 480, "block": 4, "fixed": FIXED, **changes}
    return Sweep("toy", "ippo", SPACE, **fields)


def test_points_are_random_in_ranges_and_grid_values():
    points = plan(configurations=40).points()
    assert [point["minibatches"] for point in points[:4]] == [1, 2, 1, 2]
    rates = [point["learning_rate"] for point in points]
    assert 1e-3 <= min(rates) < 3e-3 < max(rates) <= 1e-2
    assert len(set(rates)) > 35
    assert points == plan(configurations=40).points() != plan(configurations=40, seed=1).points()


def test_blocks_hold_whole_configurations_of_one_program():
    blocks = plan().blocks()
    assert [indices for indices, _ in blocks] == [[0, 2], [4], [1, 3]]
    assert [config.trainer.minibatches for _, config in blocks] == [1, 1, 2]
    assert [(member.seed, sorted(member.overrides)) for member in blocks[1][1].members] == [
        (0, ["gamma", "learning_rate"]),
        (1, ["gamma", "learning_rate"]),
    ]


@pytest.mark.slow
def test_sweep_writes_table_and_preset(tmp_path):
    space = {"learning_rate": Range(1e-3, 1e-2), "minibatches": (2,)}
    sweep = Sweep("toy", "ippo", space, configurations=2, seeds=2, steps=480, block=4, fixed=FIXED)
    reports = []
    results = run_sweep(sweep, partial(ToyEnv, match), tmp_path, advance=reports.append)
    assert reports == [320] * 6 + [0]
    assert results.select("configuration", "seed").rows() == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert results["final_return"].null_count() == 0 and not results["diverged"].any()
    assert pl.read_parquet(tmp_path / "sweep.parquet").equals(results)
    content = json.loads((tmp_path / "preset.json").read_text())
    assert content["algorithm"] == "ippo"
    settings = vars(preset("ippo", **content["hyperparameters"]))
    mean = results.group_by("configuration").agg(pl.col("final_return").mean()).sort("final_return")
    assert settings["learning_rate"] == sweep.points()[mean["configuration"][-1]]["learning_rate"]
    assert run_sweep(sweep, partial(ToyEnv, match), tmp_path).equals(
        results
    )  # finished blocks are not trained again


def test_scores_cover_last_tenth_all_and_divergence():
    rows = [
        {"member": m, "steps": 10 * u, "return": float(u), "episodes": u, "policy_loss_robot": 0.0}
        for u in range(1, 21)
        for m in range(2)
    ]
    rows[-1]["policy_loss_robot"] = float("nan")
    table = score(pl.DataFrame(rows))
    assert table["final_return"].to_list() == [pytest.approx((19 * 19 + 20 * 20) / 39), None]
    assert table["auc"].to_list() == [10.5, None]
    assert table["diverged"].to_list() == [False, True]


def test_the_best_configuration_has_no_seed_that_diverged():
    results = pl.DataFrame({"configuration": [0, 0, 1, 1], "final_return": [9.0, None, 1.0, 2.0]})
    assert best(results, [{"a": 0}, {"a": 1}]) == {"a": 1}
    with pytest.raises(ValueError, match="no configuration finished an episode with every seed"):
        best(results.head(2), [{"a": 0}])


def test_a_space_is_read_from_its_file(tmp_path):
    path = tmp_path / "space.json"
    path.write_text('{"gamma": {"low": 0.9, "high": 0.99}, "hidden": [[8, 8], [16]]}')
    assert read_space(path) == {"gamma": Range(0.9, 0.99), "hidden": ((8, 8), (16,))}
    assert make_sweep("scratch", "ippo", path).space == read_space(path)
    assert make_sweep("scratch", "masac").space == SPACES["sac"]
    with pytest.raises(ValueError, match="disability is 'd10'"):
        make_sweep("scratch", "ippo", disability="d10")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[1]", "give an object"),
        ("{}", "at least 1 item"),
        ('{"gamma": 3}', r"gamma\.Range is 3; .* give an object of hyperparameters, each"),
        ('{"gamma": []}', "give"),
        ('{"gamma": {"low": 0, "high": 1}}', "it must have 0 < low < high"),
    ],
)
def test_a_bad_space_is_named(text, message, tmp_path):
    path = tmp_path / "space.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_space(path)


def test_impossible_sweep_is_refused_before_it_starts():
    with pytest.raises(ValueError, match="epochs has a range; ranges are for learning_rate"):
        Sweep("toy", "ippo", {"epochs": Range(1, 4)})
    with pytest.raises(ValueError, match="multiple of minibatches"):
        Sweep("toy", "ippo", {"minibatches": (3,)})
    with pytest.raises(ValueError, match="block is 1; it must hold the 2 seeds"):
        plan(block=1)
