"""A folder of logs as results: nothing is lost, and what reads results reads these."""

import copy
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import assistax_zoo as az
from assistax_envs.preferences import code
from assistax_zoo.shell import main
from evaluation.figures.metrics import rank_agreement
from evaluation.people.behaviour import behaviour
from evaluation.people.beside import beside
from evaluation.people.folders import episode_table
from evaluation.people.grouping import find_logs, grouped
from evaluation.people.replaying import SCRIPT_OFF, Replayed, replay_logs
from evaluation.people.study import read_people
from evaluation.record.columns import validate_episodes
from tests.people.maker import make_log, signed, write
from zoo.registry import Registry

ROOT = Path(__file__).parents[2]
TASK = "gentle_scratch"
STUDENT = "dagger-ego-s0-v1"


@pytest.fixture
def logs(with_robot: dict[str, Any], with_script: dict[str, Any], tmp_path: Path) -> Path:
    """A folder of logs of recorded mouse paths: two that count, and others."""
    folder = tmp_path / "logs"
    write(with_robot, folder / "p01" / "a.json")
    write(with_script, folder / "p02" / "b.json")
    write(signed({**with_robot, "saved": "2026-11-30T10:00:00Z"}), folder / "p02" / "copy.json")
    broken = copy.deepcopy(with_robot)
    broken["result"]["return"] += 5.0
    write(signed(broken), folder / "p01" / "better.json")
    (folder / "none.json").write_text("{}")
    return folder


@pytest.mark.slow
def test_every_file_is_listed_with_its_fate(logs: Path, tmp_path: Path, registry: Registry) -> None:
    out = tmp_path / "out"
    found = read_people(logs, out, registry)
    listed = json.loads((out / "people.json").read_text())
    names = {
        kind: sorted(Path(name).name for name in listed[kind])
        for kind in listed
        if kind != "folder"
    }
    assert names == {
        "accepted": ["a.json", "b.json"],
        "left_out": ["copy.json"],
        "refused": ["better.json", "none.json"],
    }
    assert found.logs == 5
    assert "same episode as" in found.left_out[str(logs / "p02" / "copy.json")]
    assert "its result says return" in found.refused[str(logs / "p01" / "better.json")]
    table = az.load_result(out / TASK / STUDENT).episodes
    [row] = table.iter_rows(named=True)
    assert (row["partner"], row["partner_algorithm"], row["side"]) == (
        "people/p01",
        "people",
        "test",
    )
    assert row["return"] == pytest.approx(float(table["return"][0]))
    again = read_people(logs, out, registry)
    assert again.accepted == found.accepted  # reading anew replaces


def test_a_folder_without_a_true_log_writes_nothing(tmp_path: Path, registry: Registry) -> None:
    logs, out = tmp_path / "logs", tmp_path / "out"
    logs.mkdir()
    with pytest.raises(ValueError, match=r"no \.json file"):
        read_people(logs, out, registry)
    (logs / "none.json").write_text("{}")
    with pytest.raises(ValueError, match=r"fits its episode; none\.json: its format is None"):
        read_people(logs, out, registry)
    assert not out.exists()
    write({}, logs / "Ann Smith" / "a.json")
    with pytest.raises(ValueError, match="no name of a person"):
        read_people(logs, out, registry)
    assert main.run(["people", str(tmp_path / "nowhere"), "--out", str(out)]) == 1


def test_results_of_others_are_not_replaced(logs: Path, tmp_path: Path, registry: Registry) -> None:
    out = tmp_path / "out"
    place = out / TASK / STUDENT
    place.mkdir(parents=True)
    (place / "episodes.parquet").write_bytes(b"somebody's")
    with pytest.raises(ValueError, match="not of people"):
        read_people(logs, out, registry)
    assert (place / "episodes.parquet").read_bytes() == b"somebody's"


@pytest.mark.slow
def test_replaying_a_folder_of_people_names_the_logs(
    logs: Path, tmp_path: Path, registry: Registry, capsys
) -> None:
    read_people(logs, tmp_path / "out", registry)
    assert main.run(["replay", str(tmp_path / "out" / TASK / "script")]) == 1
    assert "replay each log" in capsys.readouterr().err
    assert main.run(["verify", str(tmp_path / "out" / TASK / "script")]) == 0


@pytest.fixture(scope="module")
def study(registry: Registry, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recorded mouse paths with wishes of their own, each with two robots and two starts."""
    folder, path = tmp_path_factory.mktemp("study"), 0
    for who in range(4):
        for block in (1, 2):
            for robot in (0, "script"):
                path += 1
                content = make_log(
                    TASK,
                    registry,
                    robot=robot,
                    start=10 * who + block,
                    path=path,
                    wish={"force": 2.0 + who, "speed": 0.03 + 0.01 * who},
                    study={"blind": True, "block": block, "order": None},
                )
                write(content, folder / f"p{who}" / f"{block}-{robot}.json")
    return folder


@pytest.mark.slow
def test_everything_that_reads_results_reads_people(
    study: Path, tmp_path: Path, registry: Registry, capsys
) -> None:
    found = read_people(study, tmp_path, registry)
    [task] = found.tasks
    assert (task.people, task.episodes, len(found.accepted)) == (4, 16, 16)
    student, script = (str(tmp_path / TASK / name) for name in (STUDENT, "script"))
    assert main.run(["compare", student, script]) == 0
    assert "4 partners" in capsys.readouterr().out
    for words in (
        ["report", student, "--out", str(tmp_path / "page.html")],
        ["plot", "adaptation", student, "--out", str(tmp_path / "a.png")],
        ["plot", "zsc", student, script, "--out", str(tmp_path / "z.png")],
        ["verify", student],
    ):
        assert main.run(words) == 0, words
    assert "no log proves" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_every_step_is_written_as_trajectories_are(
    logs: Path, tmp_path: Path, with_robot: dict[str, Any]
) -> None:
    out = tmp_path / "out"
    assert main.run(["people", str(logs), "--out", str(out), "--steps", "parquet"]) == 0
    table = pl.read_parquet(out / "steps" / f"{TASK}-{STUDENT}.parquet")
    assert table.height == with_robot["steps"] + 1
    [row] = az.load_result(out / TASK / STUDENT).episodes.iter_rows(named=True)
    assert table["reward"].sum() == pytest.approx(row["return"], abs=1e-3)
    about = json.loads(
        pl.read_parquet_metadata(out / "steps" / f"{TASK}-{STUDENT}.parquet")["assistax"]
    )
    assert about["episodes"] == [
        {"partner": "people/p01", "log": with_robot["sha256"], "start": with_robot["start"]}
    ]
    words = table["word"].drop_nulls().to_numpy()
    assert (words > 0).sum() == 6  # as the mouse path says them
    assert main.run(["people", str(logs), "--out", str(out), "--steps", "minari"]) == 0


def test_the_docs_plan_runs() -> None:
    page = (ROOT / "docs" / "people.md").read_text(encoding="utf-8")
    [example] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(example, {})


@pytest.mark.slow
def test_a_person_who_played_less_is_left_out_or_decides(study: Path, registry: Registry) -> None:
    paths = [
        path for path in find_logs(study) if path.name != "2-script.json" or "p1" in path.parts
    ]
    true = [one for one in replay_logs(paths, registry) if isinstance(one, Replayed)]
    assert len(true) == 13
    least = grouped(study, true)
    assert {one.episode for one in least.placed} == {0} and len(least.left_out) == 5
    two = grouped(study, true, 2)
    with_script = {one.partner for one in two.placed if one.replayed.robot.name == "script"}
    assert with_script == {"people/p1"} and len(two.left_out) == 3
    validate_episodes(episode_table(two.placed))
    with pytest.raises(ValueError, match="no person has 3 episodes"):
        grouped(study, true, 3)


@pytest.mark.slow
def test_a_person_with_two_wishes_is_two_partners(study: Path, registry: Registry) -> None:
    true = [one for one in replay_logs(find_logs(study), registry) if isinstance(one, Replayed)]
    one_folder = study / "p0"  # as if p0's and p1's logs were of one person
    for one in true:
        path = one.recorded.path
        if "p1" in path.parts:
            object.__setattr__(one.recorded, "path", one_folder / f"second-{path.name}")
    partners = {one.partner for one in grouped(study, true).placed}
    assert partners == {"people/p0.1", "people/p0.2", "people/p2", "people/p3"}


@pytest.mark.slow
def test_a_log_with_the_told_script_plays_again(place: Path, registry: Registry) -> None:
    write(make_log(TASK, registry, robot="told-script", start=8, path=9), place)
    [outcome] = replay_logs([place], registry)
    assert isinstance(outcome, Replayed) and outcome.off < SCRIPT_OFF


def test_behaviour_is_counted_as_it_is_said() -> None:
    steps = {
        "moved": np.full(500, 0.02),
        "force": np.where(np.arange(500) < 200, 6.0, 0.0),
        "done": np.full((500, 2), [8.0, 0.04]),
        "judged": np.repeat((np.arange(500) < 200)[:, None], 2, axis=1),
        "liked": np.full((500, 2), [4.0, 0.04]),
    }
    words = np.zeros(500, np.int8)
    words[[30, 31, 300]] = code("softer"), code("softer"), code("good")
    found = behaviour(TASK, steps, words)
    assert found == pytest.approx({"pace": 1.0, "delay": 0.6, "force": 6.0, "words": 18.0})
    nothing = behaviour(TASK, steps | {"force": np.zeros(500)}, np.zeros(500, np.int8))
    assert nothing["delay"] is None and nothing["force"] is None and nothing["words"] == 0.0


def test_delay_begins_anew_with_each_time_a_wish_is_off() -> None:
    done = np.full((500, 2), [4.0, 0.04])
    done[100:150, 0] = done[300:400, 0] = 8.0
    steps = {
        "moved": np.zeros(500),
        "force": np.ones(500),
        "done": done,
        "judged": np.ones((500, 2), bool),
        "liked": np.full((500, 2), [4.0, 0.04]),
    }
    words = np.zeros(500, np.int8)
    words[[160, 350]] = code("softer")  # the first is said when it is over, the second after 1 s
    assert behaviour(TASK, steps, words)["delay"] == pytest.approx(1.0)
    words[320] = code("harder")  # which asks for the contrary
    assert behaviour(TASK, steps, words)["delay"] == pytest.approx(1.0)


def test_ranks_agree_as_scipy_says() -> None:
    from scipy.stats import kendalltau

    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(5, 30)), rng.normal(size=(5, 40))
    a += np.arange(5)[:, None]
    b += np.array([0.0, 2.0, 1.0, 3.0, 4.0])[:, None]
    found = rank_agreement(a, b)
    assert found is not None
    assert found.tau.value == pytest.approx(kendalltau(a.mean(axis=1), b.mean(axis=1)).statistic)
    assert found.places == ((5, 4, 3, 2, 1), (5, 3, 4, 2, 1))
    low, high = found.tau.value_ci or (math.nan, math.nan)
    assert low <= 0.8 <= high <= 1.0 and low > 0.0
    reversed_ = rank_agreement(a, -a)
    assert reversed_ is not None and reversed_.tau.value == pytest.approx(-1.0)
    assert rank_agreement(a[:1], b[:1]) is None
    assert rank_agreement(np.zeros((3, 4)), b[:3]) is None
    some = a.copy()
    some[0, 1:] = np.nan  # met one partner alone
    assert rank_agreement(some, b) is not None


def test_ranks_are_of_robots_that_both_met() -> None:
    def table(means: dict[str, float], partners: int) -> pl.DataFrame:
        rng = np.random.default_rng(1)
        rows = [
            {"ego": ego, "partner": f"x{p}", "return": mean + rng.normal(), "success": mean > 5.0,
             "discomfort_share": 0.5 - mean / 100.0}
            for ego, mean in means.items() for p in range(partners)
        ]  # fmt: skip
        return pl.DataFrame(rows)

    people = table({"a": 1.0, "b": 9.0, "c": 20.0, "only people": 3.0}, 6)
    persons = table({"a": 10.0, "b": 90.0, "c": 200.0, "only persons": 5.0}, 20)
    earned, success, hurt = beside(people, persons)
    assert earned.robots == ("c", "b", "a") == hurt.robots
    assert earned.agreement is not None and earned.agreement.tau.value == pytest.approx(1.0)
    assert hurt.people == pytest.approx((0.3, 0.41, 0.49))
    assert success.people == (1.0, 1.0, 0.0)
    with pytest.raises(ValueError, match="evaluate the same robots"):
        beside(people, persons.filter(pl.col("ego") == "only persons"))
