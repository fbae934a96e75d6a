import collections
import dataclasses
import json
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_workshop.plans.learning_curves import thin, write_curves
from assistax_workshop.plans.plan import Group, planned_runs, read_plan
from population.config import TrainConfig, make_members
from population.hyperparameters import PPOConfig, preset
from population.runs.folder import RunFolder

PAPER = Path(__file__).parents[2] / "zoo" / "plans" / "paper.json"
GROUP: dict[str, Any] = {"name": "scratch-ippo", "task": "scratch", "algorithm": "ippo"}
GROUP |= {"steps": 1000, "disabilities": ["d1", "d3"], "seeds": 3}


def test_the_first_release_is_the_papers_table_6():
    counts = collections.Counter(
        (group.task, group.algorithm, member.disability)
        for group in read_plan(PAPER).groups
        for member in group.members
    )
    every, first_four = [f"d{n}" for n in range(1, 10)], ["d1", "d2", "d3", "d4"]
    table = {}
    for task, few in (("scratch", every), ("bed_bath", first_four), ("arm_assist", first_four)):
        table |= {(task, "ippo"): (few, 8), (task, "mappo"): (few, 8), (task, "masac"): (every, 6)}
    assert counts == {
        (*row, setting): seeds for row, (settings, seeds) in table.items() for setting in settings
    }
    tasks = collections.Counter(task for task, _, _ in counts.elements())
    assert tasks == {"scratch": 198, "bed_bath": 118, "arm_assist": 118} and counts.total() == 434


def plan(tmp_path, *groups, **changes):
    path = tmp_path / "plan.json"
    path.write_text(json.dumps({"version": 1, "release": "v1", "groups": list(groups), **changes}))
    return path


def test_numbers_of_seeds_and_lists_of_them(tmp_path):
    path = plan(
        tmp_path,
        GROUP,
        {**GROUP, "name": "more", "seeds": [3, 7], "set": {"gamma": 0.9, "hidden": [8, 8]}},
    )
    first, more = read_plan(path).groups
    assert (first.seeds, more.seeds) == ((0, 1, 2), (3, 7))
    assert [member.label for member in more.members] == ["d1-s3", "d1-s7", "d3-s3", "d3-s7"]
    config = more.config(more.members)
    assert isinstance(config.trainer, PPOConfig)
    assert (config.trainer.gamma, config.trainer.hidden) == (0.9, (8, 8))
    assert (config.checkpoint_every, config.updates_per_call) == (20, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "sac"}, "algorithm is 'sac'; allowed are ippo, mappo, isac, masac, mep"),
        ({"task": "swim"}, "task is 'swim'; allowed are scratch, bed_bath, arm_assist"),
        ({"disabilities": ["d1", "d10"]}, "disability is 'd10'; allowed are d1, d2"),
        ({"disabilities": "d1"}, "groups.0.disabilities is 'd1'; it must be a valid array"),
        ({"disabilities": ["d1", "d1"]}, "groups.0: two members of a run are identical"),
        ({"seeds": 0}, "groups.0: a run has no members; give at least one seed"),
        ({"seeds": True}, "groups.0.seeds is True; it must be a valid"),
        ({"seeds": [1, 1]}, "groups.0: two members of a run are identical"),
        ({"seeds": [-1]}, "groups.0: seed is -1; it must be greater than or equal to 0"),
        ({"steps": 0}, "groups.0.steps is 0; it must be greater than 0"),
        ({"steps": "10M"}, "groups.0.steps is '10M'; it must be a valid integer"),
        ({"set": {"speed": 9}}, "unknown hyperparameter speed of ippo; allowed are"),
        ({"max_members": 0}, "groups.0.max_members is 0; it must be greater than 0"),
        ({"adopt": "old"}, "groups.0.adopt is 'old'; String should match pattern '^v"),
        ({"adopt": "v1"}, "group scratch-ippo adopts 'v1', the plan's own release"),
        ({"name": "scratch-2"}, "it must be lower-case words joined by '-', the last one not a"),
        ({"name": "../x"}, "name is '../x'; it must be lower-case words"),
        ({"seed": 3}, "unknown field groups.0.seed"),
    ],
)
def test_a_bad_group_gets_one_clear_error(tmp_path, changes, message):
    with pytest.raises(ValueError) as caught:
        read_plan(plan(tmp_path, {**GROUP, **changes}))
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"plan {tmp_path / 'plan.json'}: ")


@pytest.mark.parametrize(
    ("groups", "changes", "message"),
    [
        ([GROUP], {"version": 2}, "version is 2; it must be 1"),
        ([GROUP], {"release": "one"}, "release is 'one'; String should match pattern '^v"),
        ([GROUP], {"owner": "me"}, "unknown field owner"),
        ([], {}, "groups is []; Tuple should have at least 1 item"),
        ([3], {}, "groups.0 is 3; it must be an object"),
        ([{"name": "x"}], {}, "groups.0.task is missing"),
        ([GROUP, GROUP], {}, "two groups have the name 'scratch-ippo'"),
        (
            [GROUP, {**GROUP, "name": "again", "disabilities": ["d3"], "seeds": [2]}],
            {},
            "groups scratch-ippo and again both have team scratch/ippo-d3-s2; leave it out of one",
        ),
    ],
)
def test_a_bad_plan_gets_one_clear_error(tmp_path, groups, changes, message):
    with pytest.raises(ValueError) as caught:
        read_plan(plan(tmp_path, *groups, **changes))
    assert message in str(caught.value)


def labels(blocks):
    return {
        block.name: (block.state, [member.label for member in block.members]) for block in blocks
    }


def begin(group, folder, members):
    RunFolder(folder).open(group.config(members), {"version": 1, "backend": "native"}, True)


def finish(folder, members, task="scratch", algorithm="ippo"):
    of_run = {"task": task, "algorithm": algorithm}
    teams = [{**of_run, "disability": m.disability, "seed": m.seed} for m in members]
    teams = [{"team": team} for team in teams]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "teams.json").write_text(json.dumps(teams))


def test_a_group_is_cut_into_blocks(tmp_path):
    group = Group(**{**GROUP, "max_members": 4})
    assert labels(planned_runs(group, tmp_path)) == {
        "scratch-ippo": ("new", ["d1-s0", "d1-s1", "d1-s2", "d3-s0"]),
        "scratch-ippo-2": ("new", ["d3-s1", "d3-s2"]),
    }
    assert labels(planned_runs(group, tmp_path, {("d1", 0), ("d3", 2)})) == {
        "scratch-ippo": ("new", ["d1-s1", "d1-s2", "d3-s0", "d3-s1"])
    }


def test_run_folders_do_not_depend_on_publication(tmp_path):
    group = Group(**{**GROUP, "max_members": 2})
    first, second, third = planned_runs(group, tmp_path)
    begin(group, second.folder, second.members)
    expected = labels([first, dataclasses.replace(second, state="begun"), third])
    assert labels(planned_runs(group, tmp_path)) == expected
    published = {(member.disability, member.seed) for member in second.members[:1]}
    assert labels(planned_runs(group, tmp_path, published)) == expected
    finish(first.folder, first.members)
    longer = dataclasses.replace(group, steps=2000, seeds=4)
    assert labels(planned_runs(longer, tmp_path, first.keys)) == {
        "scratch-ippo-2": ("begun", ["d1-s2", "d3-s0"]),
        "scratch-ippo-3": ("new", ["d1-s3", "d3-s1"]),
        "scratch-ippo-4": ("new", ["d3-s2", "d3-s3"]),
    }
    begun = next(block for block in planned_runs(longer, tmp_path) if block.state == "begun")
    assert begun.config().steps == 1000
    assert begun.differences() == "steps is 1000 there and 2000 here"


def test_group_takes_only_folders_of_its_runs(tmp_path):
    finish(tmp_path / "scratch-ippo-gru", make_members([0], ["d1"]))
    assert labels(planned_runs(Group(**GROUP), tmp_path)).keys() == {"scratch-ippo"}
    finish(tmp_path / "scratch-ippo", make_members([0], ["d1"]), task="bed_bath")
    with pytest.raises(ValueError, match="holds a run of bed_bath ippo, but group scratch-ippo is"):
        planned_runs(Group(**GROUP), tmp_path)


def curves_config(updates):
    members = make_members([0, 4], ["d1"])
    return TrainConfig(
        "scratch", "ippo", members, updates * 32, preset("ippo", num_envs=4, rollout_steps=8)
    )


def metrics(config, returns, episodes):
    """A table as `metrics_table` writes it: both members have the same values."""
    updates = range(1, config.updates + 1)
    rows = [
        {
            "update": update,
            "steps": 32 * update,
            "disability": "d1",
            "seed": seed,
            "episodes": n,
            "return": value,
        }
        for update, value, n in zip(updates, returns, episodes, strict=True)
        for seed in (0, 4)
    ]
    return pl.DataFrame(rows)


def test_curves_are_means_over_a_stretchs_episodes():
    config = curves_config(6)
    table = thin(
        metrics(config, [None, None, 10.0, 40.0, 7.0, 7.0], [0, 0, 1, 3, 2, 2]), config, points=3
    )
    assert table.columns == ["task", "algorithm", "disability", "seed", "steps", "return"]
    own = table.filter(pl.col("seed") == 4)
    assert own["steps"].to_list() == [64, 128, 192]
    assert own["return"].to_list() == [None, (10 + 3 * 40) / 4, 7.0]


def test_curves_have_success_and_harm_if_measured(tmp_path):
    config, path = curves_config(2), tmp_path / "scratch-ippo.parquet"
    plain = metrics(config, [1.0, 2.0], [1, 3])
    write_curves(path, [(plain.filter(pl.col("seed") == 0), config)])
    curves = plain.with_columns(pl.Series("success", [0.0, 0.0, 1.0, 1.0]), violated=0.5, noise=1.0)
    table = thin(curves, config, points=1)
    assert table.columns[5:] == ["return", "success", "violated"]
    assert table["success"].to_list() == [0.75, 0.75]
    paths = write_curves(path, [(curves.filter(pl.col("seed") == 4), config)])
    assert paths.filter(pl.col("seed") == 0)["violated"].to_list() == [None, None]
    assert paths.filter(pl.col("seed") == 4)["violated"].to_list() == [0.5, 0.5]


def test_long_run_has_hundred_points_a_member(tmp_path):
    config = curves_config(1234)
    table = metrics(config, [1.0] * 1234, [1] * 1234)
    write_curves(tmp_path / "curves" / "scratch-ippo.parquet", [(table, config)])
    curve = pl.read_parquet(tmp_path / "curves" / "scratch-ippo.parquet")
    assert curve.group_by("seed").len()["len"].to_list() == [100, 100]
    assert curve["steps"].max() == 1234 * 32 and set(curve["return"]) == {1.0}


def test_curves_of_other_members_stay_in_the_file(tmp_path):
    config, path = curves_config(2), tmp_path / "scratch-ippo.parquet"
    table = metrics(config, [1.0, 2.0], [1, 1])
    write_curves(path, [(table, config)])
    before = path.read_bytes()
    write_curves(path, [(table.filter(pl.col("seed") == 4), config)])
    assert path.read_bytes() == before
    other = table.filter(seed=4).with_columns(pl.lit(9.0).alias("return"))
    write_curves(path, [(other, config)])
    written = pl.read_parquet(path)
    returns = {seed: set(rows["return"]) for (seed,), rows in written.group_by("seed")}
    assert returns == {0: {1.0, 2.0}, 4: {9.0}}
