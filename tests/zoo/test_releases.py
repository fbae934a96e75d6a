"""The paper's population is whole and can be split in every way; the care track has persons."""

import re
from collections import Counter
from pathlib import Path

import pytest

from assistax_envs.persons.rows import COUNT
from assistax_envs.registered import CARE, PAPER, track_of
from assistax_envs.versions import CARE_TASKS, GENTLE_TASKS, PAPER_TASKS, TASKS, VERSIONS
from tools.release_page.paper.data import read_paper
from zoo.ids import EGO
from zoo.registry import load_registry

ROOT = Path(__file__).parents[2]
REGISTRY = load_registry(ROOT / "registry.json")
PERSONS_TASKS = (*GENTLE_TASKS, *CARE_TASKS)


@pytest.mark.parametrize("role", ["human", "robot"])
def test_release_v1_is_table_6(role: str) -> None:
    teams = [e for e in REGISTRY.select(release="v1", role=role) if e.disability != EGO]
    counts = Counter((e.task, e.algorithm, e.disability) for e in teams)
    expected = {
        (task, algorithm, f"d{setting}"): settings["seeds"]
        for task, algorithms in read_paper()["population"].items()
        for algorithm, settings in algorithms.items()
        for setting in range(1, settings["settings"] + 1)
    }
    assert counts == expected and counts.total() == 434
    assert all(entry.self_play for entry in teams)


def test_egos_were_trained_on_published_splits() -> None:
    egos = REGISTRY.data.egos
    of_tracks = Counter(track_of(team.partition("/")[0]) for team in egos)
    assert of_tracks == {PAPER: len(PAPER_TASKS), CARE: 3 * len(PERSONS_TASKS)}
    for team, ego in egos.items():
        split = REGISTRY.split(team.partition("/")[0], release=team.rpartition("-")[2])
        assert (ego.trained_against.split, ego.trained_against.sha256) == (split.id, split.sha256)


@pytest.mark.parametrize("task", PERSONS_TASKS)
def test_care_tasks_have_persons_and_three_robots_with_a_memory(task: str) -> None:
    assert REGISTRY.data.releases["v1"].persons[task].count == COUNT
    robots = REGISTRY.select(task=task, release="v1")
    assert {entry.role for entry in robots} == {"robot"}
    assert list(Counter(entry.algorithm for entry in robots).values()) == [3]
    assert all(entry.spec.torso != "mlp" or entry.spec.latent for entry in robots)


def test_task_has_default_and_leave_one_out_splits() -> None:
    splits = [split for split in REGISTRY.splits if split.release == "v1"]
    held_out = {(split.task, split.held_out) for split in splits if split.held_out}
    names = ["ippo", "mappo", "masac", *(f"d{setting}" for setting in range(1, 10))]
    assert held_out == {
        (task, name) for task in ("scratch", "bed_bath", "arm_assist") for name in names
    }
    for split in splits:
        # It is intact, and has no parameters on both sides.
        assert REGISTRY.split(split.task, split.id) == split
        if split.held_out:
            named = re.compile(f"[-/]{split.held_out}-").search
            assert all(map(named, split.test)) and not any(map(named, split.train))
    sizes = {task: len(REGISTRY.split(task).test) for task in ("scratch", "bed_bath", "arm_assist")}
    assert sizes == {"scratch": 99, "bed_bath": 59, "arm_assist": 59}


def test_one_release_holds_both_tracks() -> None:
    assert {REGISTRY.release_of(task) for task in TASKS} == {"v1"}
    assert REGISTRY.split("scratch", "half").release == "v1"
    assert REGISTRY.release == max(REGISTRY.data.releases) == "v1"


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_robots_and_partners(task: str) -> None:
    release = REGISTRY.release_of(task)
    version = REGISTRY.data.releases[release].environments[task]
    robots = [entry for entry in REGISTRY.of_task(task, "robot") if entry.disability == EGO]
    assert robots and version == VERSIONS[task]
    assert REGISTRY.split(task).test
