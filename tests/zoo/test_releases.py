"""Release v1 is the paper's population, whole, and can be split in every way; v3 is its plan's."""

import itertools
import re
import statistics
from collections import Counter
from pathlib import Path

import pytest

from assistax_envs.versions import GENTLE_TASKS, PAPER_TASKS, TASKS, VERSIONS
from assistax_workshop.plans.plan import read_plan
from tools.release_page.paper.data import read_paper
from zoo.ids import EGO
from zoo.registry import load_registry
from zoo.splitting.create import partner_teams

ROOT = Path(__file__).parents[2]
REGISTRY = load_registry(ROOT / "registry.json")


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
    assert len(egos) == 15
    for team, ego in egos.items():
        release = team.rpartition("-")[2]
        whom = "persons" if release == "v3" else None
        whom = "three-sides" if team.endswith("-s102-v3") else whom
        alone = {"release": release} if whom is None else {}
        split = REGISTRY.split(team.partition("/")[0], whom, **alone)
        assert (ego.trained_against.split, ego.trained_against.sha256) == (split.id, split.sha256)


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


def test_release_v3_is_its_plan() -> None:
    plan = read_plan(ROOT / "zoo" / "plans" / "v3.json")
    expected = {
        f"{group.task}/{group.algorithm}-{member.label}-v3"
        for group in plan.groups
        for member in group.members
    }
    humans = [e for e in REGISTRY.select(release="v3", role="human") if e.disability != EGO]
    assert {entry.team for entry in humans} == expected
    assert Counter(entry.task for entry in humans) == dict.fromkeys(GENTLE_TASKS, 36)
    assert all(entry.self_play for entry in humans)


@pytest.mark.parametrize("task", GENTLE_TASKS)
def test_no_partner_in_v3_splits_is_below_bar(task: str) -> None:
    data = REGISTRY.part("").data
    teams = partner_teams(data, task, "v3")
    own = {team: data.teams[team].self_play for team in teams}
    earned = {team: figure.mean for team, figure in own.items() if figure is not None}
    assert len(earned) == 36
    bar = 0.25 * statistics.median(earned.values())
    fit = {team for team in teams if earned[team] >= bar}
    splits = [s for s in data.splits if (s.task, s.release) == (task, "v3")]
    assert {split.rule for split in splits} == {"half", "three-sides"}
    assert all({*itertools.chain(*split.sides.values())} == fit for split in splits)
    assert REGISTRY.split(task, release="v3").rule == "three-sides"


def test_a_task_has_its_own_default_release() -> None:
    releases = {task: REGISTRY.release_of(task) for task in TASKS}
    assert releases == {
        **dict.fromkeys(PAPER_TASKS, "v1"),
        **dict.fromkeys(GENTLE_TASKS, "v3"),
        "gentle_brushing": "v4",
        "gentle_feeding": "v5",
    }
    assert REGISTRY.split("scratch", "half").release == "v1"
    assert REGISTRY.release == max(REGISTRY.data.releases) == "v5"


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_robots_and_partners(task: str) -> None:
    release = REGISTRY.release_of(task)
    version = REGISTRY.data.releases[release].environments[task]
    robots = [entry for entry in REGISTRY.of_task(task, "robot") if entry.disability == EGO]
    assert robots and version == VERSIONS[task]
    assert REGISTRY.split(task).test
