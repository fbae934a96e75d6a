"""The published population is the paper's, whole, and can be split in every way."""

from collections import Counter
from pathlib import Path

import pytest

from tools.paper_page.data import read_paper
from zoo.ids import EGO
from zoo.registry import load_registry

ROOT = Path(__file__).parents[2]
REGISTRY = load_registry(ROOT / "registry.json")


@pytest.mark.parametrize("role", ["human", "robot"])
def test_release_v1_is_table_6(role: str) -> None:
    teams = [e for e in REGISTRY.select(release="v1", role=role) if e.disability != EGO]
    found = Counter((e.task, e.algorithm, e.disability) for e in teams)
    wanted = {
        (task, algorithm, f"d{setting}"): told["seeds"]
        for task, algorithms in read_paper()["population"].items()
        for algorithm, told in algorithms.items()
        for setting in range(1, told["settings"] + 1)
    }
    assert found == wanted and found.total() == 434
    assert all(entry.self_play for entry in teams)
    assert REGISTRY.release == "v1"


def test_each_task_has_an_ego_of_the_training_half() -> None:
    egos = REGISTRY.data.egos
    assert sorted(egos) == [
        f"{task}/ppo-ego-s0-v1" for task in ("arm_assist", "bed_bath", "scratch")
    ]
    for team, ego in egos.items():
        split = REGISTRY.split(team.partition("/")[0])
        assert (ego.trained_against.split, ego.trained_against.sha256) == (split.id, split.sha256)


def test_every_task_has_its_default_and_leave_one_out_splits() -> None:
    splits = [split for split in REGISTRY.splits if split.release == "v1"]
    held_out = {(split.task, split.held_out) for split in splits if split.held_out}
    names = ["ippo", "mappo", "masac", *(f"d{setting}" for setting in range(1, 10))]
    assert held_out == {
        (task, name) for task in ("scratch", "bed_bath", "arm_assist") for name in names
    }
    for split in splits:
        assert (
            REGISTRY.split(split.task, split.id) == split
        )  # intact, and no parameters on both sides
        if split.held_out:
            assert all(
                f"-{split.held_out}-" in team or f"/{split.held_out}-" in team
                for team in split.test
            )
            assert not any(
                f"-{split.held_out}-" in team or f"/{split.held_out}-" in team
                for team in split.train
            )
    sizes = {task: len(REGISTRY.split(task).test) for task in ("scratch", "bed_bath", "arm_assist")}
    assert sizes == {"scratch": 99, "bed_bath": 59, "arm_assist": 59}
