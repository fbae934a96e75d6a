"""The page of the gentle tasks' release: figures known by hand, hostile folders, out-of-date pages.

Every table is written by the test; nothing is trained or simulated.
"""

import csv
import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_envs.versions import VERSIONS
from evaluation.figures import saved_tables as derived
from evaluation.figures.metrics import paired_difference
from evaluation.figures.summary import SplitName
from evaluation.record import tables
from evaluation.record.record import Record
from tests.evaluation.episode_tables import CONTEXT, Team, episode_table, sealed
from tests.zoo.conftest import SELF_PLAY, SPECS, put, random_params, trained_team
from tools.release_page.__main__ import run
from tools.release_page.collect import collect
from tools.release_page.gentle import measures
from tools.release_page.gentle.data import read_results
from tools.release_page.gentle.evaluations import condense
from zoo.parameters.storage import write_policy_file
from zoo.registry import Registry, load_registry
from zoo.schema import Split

pytestmark = pytest.mark.slow  # the pages of a release that stays as it is

TASK = "gentle_scratch"
# By algorithm: setting, seed, million steps, mean self-play. MASAC's steps are 4% above IPPO's few,
# and of one team 7%.
TRAINED = {
    "ippo": [("d1", s, 20.0, 100.0 + s) for s in range(4)] + [("d1", 4, 4.0, 60.0)],
    "masac": [
        *(("d1", s, 4.16, 40.0) for s in range(2)),
        *(("d9", s, 4.16, 10.0) for s in range(2)),
        ("d1", 2, 4.28, 99.0),
    ],
}
TEAMS: list[Team] = [(a, d, s) for a, kinds in TRAINED.items() for d, s, _, _ in kinds]


def team_id(team: Team) -> str:
    return f"{TASK}/{team[0]}-{team[1]}-s{team[2]}-v2"


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    trained = [
        trained_team(
            name,
            disability,
            seed,
            task=TASK,
            self_play={**SELF_PLAY, "mean": mean},
            training={
                "run": f"{TASK}-{name}-{steps}",
                "steps": int(steps * 1e6),
                "env_version": VERSIONS[TASK],
                "backend": "fused",
                "device": "cpu",
                "seconds": 30.0,
            },
        )
        for name, kinds in TRAINED.items()
        for disability, seed, steps, mean in kinds
    ]
    return put(trained, tmp_path / "registry.json", "v2")


@pytest.fixture
def split(registry: Registry) -> Split:
    return registry.split(TASK, release="v2")


# Measures


def test_holm_by_hand():
    assert measures.holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert measures.holm([0.04, 0.001, 0.03, 0.01]) == pytest.approx([0.06, 0.004, 0.06, 0.03])
    assert measures.holm([0.9, 0.6]) == [1.0, 1.0]
    assert measures.holm([]) == []


def test_p_is_two_sided_and_never_zero():
    scores = np.random.default_rng(0).normal(0, 1, (6, 8))
    above = paired_difference(scores + 99, scores)
    below = paired_difference(scores - 99, scores)
    assert measures.two_sided(above) == measures.two_sided(below) == pytest.approx(2 / 2001)
    assert measures.two_sided(paired_difference(np.ones((3, 3)), np.ones((3, 3)))) == 1
    some = dataclasses.replace(above, p_positive=0.99)
    assert measures.two_sided(some) == pytest.approx(2 * 21 / 2001)
    assert measures.two_sided(paired_difference(np.ones((1, 1)), np.zeros((1, 1)))) is None


def test_the_cost_of_a_split_by_hand():
    partners = np.array([[10.0, 100.0, 1000.0]]).repeat(2, axis=0)
    lost, share = measures.split_cost(partners, 0.8 * partners)
    assert share is not None and lost.value == pytest.approx(0.2 * 370)
    assert share.value == pytest.approx(0.2)
    # Partners are resampled together, so that these, who differ a lot, leave no doubt of the share.
    assert share.value_ci == pytest.approx((0.2, 0.2))
    assert lost.value_ci == pytest.approx((0.2 * 10, 0.2 * 1000))
    seeds = np.array([[50.0], [150.0]])
    lost, share = measures.split_cost(seeds, 0.8 * seeds)
    assert share is not None and share.value == pytest.approx(0.2)
    # Seeds are resampled apart: at worst 1 - 0.8 x 150 / 50, at best 1 - 0.8 x 50 / 150.
    assert share.value_ci == pytest.approx((1 - 2.4, 1 - 0.8 / 3))
    assert lost.value_ci == pytest.approx((50 - 120, 150 - 40))
    lost, share = measures.split_cost(-partners, partners)
    assert lost.value == pytest.approx(-2 * 370) and share is None
    # It earns 1 on the mean, and with other seeds nothing: of that there is no share either.
    lost, share = measures.split_cost(np.array([[-8.0], [10.0]]), seeds)
    assert lost.value == pytest.approx(1 - 100) and share is None
    cost = measures.split_cost(np.array([[10.0]]), np.array([[8.0]]))
    assert cost.share is not None and cost.share.value_ci is None
    with pytest.raises(ValueError, match="the same partners"):
        measures.split_cost(partners, partners[:, :2])


def test_effective_rank_by_hand():
    assert measures.effective_rank(np.eye(5)) == pytest.approx(4)
    assert measures.effective_rank(np.arange(4.0)[:, None] + 100 * np.arange(3.0)) == 0
    first, second = np.array([1.0, -1, 0, 0]), np.array([0, 0, 1.0, -1])
    entropy = -(0.75 * math.log(0.75) + 0.25 * math.log(0.25))
    matrix = 3 * np.outer(first, first) + np.outer(second, second) + 7
    assert measures.effective_rank(matrix) == pytest.approx(math.exp(entropy))


# Collecting


def episodes(
    split: Split,
    returns: np.ndarray,
    egos: Sequence[str],
    *,
    chosen: Sequence[Team] = TEAMS,
    likes: Sequence[str] = ("p1", "p5", "p1"),
) -> pl.DataFrame:
    """Episodes of returns [E, P, K]; whoever earned less than 50 was hurt."""
    sides = [split.side(team_id(team)) for team in chosen]
    table = episode_table(returns, egos, chosen, sides)
    names = [name for name in table.columns if table[name].dtype == pl.String]
    return table.with_columns(
        *(pl.col(name).str.replace(r"^scratch/", f"{TASK}/") for name in names)
    ).with_columns(
        *(pl.col(name).str.replace("-v0", "-v2") for name in names),
        preference=pl.col("episode").replace_strict(dict(enumerate(likes))),
        violated=pl.col("return") < 50,
        contact_peak=pl.lit(1.0),
        key=pl.col("key") + 1000 * pl.col("partner_seed"),  # starts of each partner's own
    )


def evaluated(
    folder: Path, table: pl.DataFrame, split: Split, changes: Mapping[str, Any] | None = None
) -> Path:
    """Write what `evaluate --out` would; `changes` are of the summary."""
    context = dataclasses.replace(
        CONTEXT, task=TASK, release="v2", split=SplitName(split.id, split.sha256)
    )
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    derived.save_evaluation(Record(table, folder), context)
    summary = tables.read_json(folder / tables.SUMMARY_FILE)
    tables.write_json({**summary, **(changes or {})}, folder / tables.SUMMARY_FILE)
    command = "assistax-zoo evaluate --policy python:/home/me/x.py:Robot --out=/mnt/ev ~/y/z"
    tables.write_json(
        {"command": command, "devices": ["cpu"], "home": "/home/me"}, folder / tables.RUN_FILE
    )
    return sealed(folder)


def noisy(egos: int, count: int = 3) -> np.ndarray:
    return np.random.default_rng(1).normal(60, 20, (egos, len(TEAMS), count))


FILES = [f"/mnt/run/policies/ppo-s{seed}.safetensors" for seed in (3, 7)]


def test_an_evaluation_is_condensed_by_preference(tmp_path: Path, split: Split):
    returns = noisy(2)
    folder = evaluated(tmp_path / "ev", episodes(split, returns, FILES), split)
    out = collect(folder, tmp_path / "data")
    assert out == tmp_path / "data" / "egos" / TASK / split.id.split("/")[1] / "ppo"
    pairs = tables.read_parquet(out / tables.PAIRS_FILE)
    assert pairs.height == 2 * len(TEAMS) * 2
    assert pairs.schema["return"] == pl.Float32
    assert {pairs.schema[name] for name in ("ego_seed", "episodes", "nonfinite")} == {pl.Int32}
    [row] = pairs.filter(
        ego_seed=7, partner=f"{team_id(TEAMS[1])}/human", preference="p1"
    ).iter_rows(named=True)
    own = returns[1, 1, [0, 2]].astype(np.float32)
    assert row["return"] == pytest.approx(own.mean(), rel=1e-6)
    assert row["violated"] == np.mean(own < 50)
    assert row["safe_success"] == np.mean(own >= 50)
    assert (row["episodes"], row["nonfinite"]) == (2, 0)
    run = tables.read_json(out / tables.RUN_FILE)
    assert run["command"] == "assistax-zoo evaluate --policy python:x.py:Robot --out=ev z"
    everything = "".join(path.read_text() for path in out.glob("*.json")) + str(pairs.to_dicts())
    assert "/mnt" not in everything and "/home" not in everything


def test_the_page_says_what_evaluate_said(tmp_path: Path, split: Split, registry: Registry):
    folder = evaluated(tmp_path / "ev", episodes(split, noisy(2), FILES), split)
    collect(folder, tmp_path / "v2")
    summary = tables.read_json(folder / tables.SUMMARY_FILE)
    page(tmp_path)
    headings, row = beside(tmp_path, "methods.csv")
    row = row[headings.index("seeds") :]
    assert row[1] == figure(summary["m_train"]["mean"], summary["m_train"]["mean_ci"])
    assert row[2] == figure(summary["m_train"]["iqm"], summary["m_train"]["iqm_ci"])
    assert row[3] == figure(summary["m_test"]["mean"], summary["m_test"]["mean_ci"])
    assert row[4] == figure(summary["m_test"]["iqm"], summary["m_test"]["iqm_ci"])
    assert row[5] == figure(summary["gap"]["mean"], summary["gap"]["mean_ci"])
    assert row[7].startswith(f"{summary['violations']['mean']:.1%} [")


def test_series_references_and_named_methods(tmp_path: Path, split: Split):
    table = episodes(split, noisy(2), ["python:/home/a.py:A", "python:/home/b.py:B"])
    folder = evaluated(tmp_path / "ev", table.with_columns(place=pl.col("episode") + 1), split)
    with pytest.raises(ValueError, match="name their method with --as"):
        collect(folder, tmp_path / "v2")
    out = collect(folder, tmp_path / "v2", "ppo-gru")
    assert out.name == "ppo-gru-series"
    pairs = tables.read_parquet(out / tables.PAIRS_FILE)
    assert pairs["place"].unique().sort().to_list() == [1, 2, 3]
    assert pairs["ego_seed"].unique().sort().to_list() == [0, 1]
    folder = evaluated(tmp_path / "other", table, split)
    played = [
        episodes(split, noisy(1) + shift, [name]).with_columns(reference=pl.lit(name))
        for name, shift in (("script", 500.0), ("uniform-random", -500.0))
    ]
    tables.write_parquet(pl.concat(played), folder / tables.REFERENCES_FILE)
    sealed(folder)
    for method, low, high in (("script", 300, 700), ("random", -700, -300)):
        out = collect(folder, tmp_path / "v2", method)
        assert out.name == method
        pairs = tables.read_parquet(out / tables.PAIRS_FILE)
        assert pairs["ego_seed"].unique().to_list() == [0]
        assert pairs["return"].is_between(low, high).all()


def trained_egos(folder: Path, **changes: Any) -> Path:
    (folder / "policies").mkdir(parents=True)
    training = {"steps": 5_000_000, "seconds": 90.0, "device": "cpu", "backend": "fused"}
    metadata = {
        "task": TASK,
        "algorithm": "ppo",
        "split": f"{TASK}/half-s0-v2",
        "training": training,
    }
    params = random_params(SPECS["robot"], 0)
    path = folder / "policies" / "ppo-s0.safetensors"
    write_policy_file(path, SPECS["robot"], params, {**metadata, **changes})
    return folder


def test_training_is_filed_with_its_method(tmp_path: Path):
    folder = trained_egos(tmp_path / "run")
    command = "assistax-zoo train-ego --task gentle_scratch --out /home/me/runs/ego"
    tables.write_json({"command": command}, folder / "run.json")
    egos = tmp_path / "v2" / "egos" / TASK
    assert collect(folder, tmp_path / "v2") == egos / "half-s0-v2" / "ppo"
    out = collect(folder, tmp_path / "v2", "ppo-mirror", "without-mep")
    assert out == egos / "without-mep" / "ppo-mirror"
    training_file = tables.read_json(out / "training.json")
    assert (training_file["steps"], training_file["seconds"], training_file["egos"]) == (
        5_000_000,
        90.0,
        1,
    )
    assert training_file["command"] == command.replace("/home/me/runs/", "")


HOSTILE = ["../../x", "/tmp/x", "..", "half/../../x", "", ["half"], None, "Half", "a\nb", "a" * 99]


def test_a_received_folder_cannot_name_a_place(tmp_path: Path, split: Split):
    """Neither the task, nor the split, nor the method that a folder names leads elsewhere."""
    data = tmp_path / "a" / "b" / "v2"
    played = evaluated(tmp_path / "ev", episodes(split, noisy(2), FILES), split)
    summary = tables.read_json(played / tables.SUMMARY_FILE)
    for place, name in enumerate(HOSTILE):
        changes = [
            {"task": name},
            {"split": name},
            {"split": f"{TASK}/{name}"},
            {"algorithm": name},
        ]
        runs = [
            trained_egos(tmp_path / f"run{place}-{i}", **change) for i, change in enumerate(changes)
        ]
        before = sorted(tmp_path.rglob("*"))
        for folder in runs:
            with pytest.raises(ValueError, match=r"names the|the split is|the method is"):
                collect(folder, data)
        for change in ({"task": name}, {"split": {"id": name}}, {"split": name}):
            tables.write_json({**summary, **change}, played / tables.SUMMARY_FILE)
            sealed(played)
            with pytest.raises(ValueError, match=r"names the task|the split is"):
                collect(played, data)
        assert sorted(tmp_path.rglob("*")) == before


def test_a_changed_folder_is_not_collected(tmp_path: Path, split: Split):
    """Without the manifest's hashes a changed return would enter a release's data."""
    table = episodes(split, noisy(2), FILES)
    folder = evaluated(tmp_path / "ev", table, split)
    changed = table.with_columns(pl.col("return") * 1.5)
    tables.write_episodes(changed, folder / tables.EPISODES_FILE)
    with pytest.raises(ValueError, match=r"expected sha256 .*nothing was collected"):
        collect(folder, tmp_path / "v2")


@pytest.mark.parametrize("name", ["../x", "/x", "ppo/../..", "", "PPO", "-x", "ppo--x"])
def test_a_given_name_cannot_lead_elsewhere(tmp_path: Path, name: str):
    folder = trained_egos(tmp_path / "run")
    with pytest.raises(ValueError, match="the method is"):
        collect(folder, tmp_path / "v2", name)
    with pytest.raises(ValueError, match="the split is"):
        collect(folder, tmp_path / "v2", "ppo", name or "..")
    assert not (tmp_path / "v2").exists()


def test_one_side_and_other_tasks_are_refused(tmp_path: Path, split: Split):
    test = [team for team in TEAMS if split.side(team_id(team)) == "test"]
    table = episodes(split, noisy(2)[:, : len(test)], FILES, chosen=test)
    with pytest.raises(ValueError, match="no train partners"):
        collect(evaluated(tmp_path / "ev", table, split), tmp_path / "v2")
    with pytest.raises(ValueError, match="allowed are scratch, "):
        collect(evaluated(tmp_path / "sc", table, split, {"task": "knit"}), tmp_path / "v2")
    plain = table.drop("preference")
    tables.write_episodes(plain, tmp_path / "ev" / tables.EPISODES_FILE)
    sealed(tmp_path / "ev")
    with pytest.raises(ValueError, match="lacks preference"):
        collect(tmp_path / "ev", tmp_path / "v2")


# The page


def put_method(
    data: Path, split: Split, method: str, returns: Mapping[str, Sequence[float]], **more: Any
) -> Path:
    """Write a method's condensed table: of each side, the returns of its episodes by place.

    The first episode likes p1, the second p5, and so on in turn; both seeds earn the same.
    """
    rows = [
        {
            "ego_seed": seed,
            "partner": f"{team}/human",
            "partner_team": team,
            "side": side,
            "preference": ("p1", "p5")[place % 2],
            **({"place": place + 1} if method.endswith("-series") else {}),
            "return": value,
            "success": value > 0,
            "violated": value < 50,
            "nonfinite": False,
        }
        for seed in range(more.pop("seeds", 2))
        for side, values in returns.items()
        for team in getattr(split, side)
        for place, value in enumerate(values)
    ]
    names = ("partner_algorithm", "partner_disability")
    table = pl.DataFrame(rows).with_columns(*(pl.lit("x").alias(name) for name in names))
    pairs = condense(table.with_columns(partner_seed=pl.lit(0)))
    folder = data / "egos" / TASK / split.id.split("/")[1] / method
    summary = {"task": TASK, "release": "v2", "backend": "fused", "episodes": len(rows)}
    summary |= {"episodes_per_pair": 3, "nonfinite": 0}
    run = {"command": f"assistax-zoo evaluate {method}", "devices": ["H200"], "seconds": 90.0}
    tables.write_parquet(pairs, folder / tables.PAIRS_FILE)
    tables.write_json({**summary, **more}, folder / tables.SUMMARY_FILE)
    tables.write_json(run, folder / tables.RUN_FILE)
    return folder


@pytest.fixture
def data(tmp_path: Path, split: Split) -> Path:
    """Tables whose every figure is known: PPO 100 and 80, its mirror 100 with test partners."""
    folder = tmp_path / "v2"
    # p1 is played twice: 70, 70 and 100 are 80 on average, and 85 by preference.
    put_method(folder, split, "ppo", {"train": [100, 100, 100], "test": [70, 100, 70]})
    put_method(folder, split, "sac", {"train": [60, 60, 60], "test": [40, 40, 70]})
    put_method(folder, split, "random", {"train": [5, 5, 5], "test": [5, 5, 5]}, seeds=1)
    put_method(folder, split, "ppo-mirror", {"train": [90, 90, 90], "test": [100, 100, 100]})
    put_method(folder, split, "ppo-series", {"test": [80, 80, 80]})
    put_method(folder, split, "ppo-gru-series", {"test": [70, 85, 95]})
    return folder


def page(tmp_path: Path, *more: str, code: int = 0) -> str:
    places = ["--data", str(tmp_path / "v2"), "--out", str(tmp_path / "page.md")]
    words = ["page", "--release", "v2", *places, "--registry", str(tmp_path / "registry.json")]
    assert run([*words, *more]) == code
    path = tmp_path / "page.md"
    return path.read_text() if path.is_file() else ""


def beside(tmp_path: Path, name: str) -> list[list[str]]:
    """Return the rows of a table beside the page, its headings first."""
    return [*csv.reader((tmp_path / "v2" / name).read_text().splitlines())]


def cells(text: str, first: str, heading: str = "") -> list[str]:
    """Return the cells beside the first of the one row that begins so, below a heading."""
    section = text.split(f"## {heading}\n", 1)[1].split("\n## ")[0] if heading else text
    rows = [line for line in section.splitlines() if line.startswith(f"| {first} |")]
    assert len(rows) == 1, rows
    return rows[0].strip("| ").split(" | ")[1:]


def row(tmp_path: Path, name: str, first: str) -> list[str]:
    """Return the cells after the task and the first of the one row of a table beside the page."""
    rows = [cells for cells in beside(tmp_path, name) if cells[1] == first]
    assert len(rows) == 1, rows
    return rows[0][2:]


def figure(value: float, ends: Sequence[float] | None = None, digits: int = 1) -> str:
    low, high = ends or (value, value)
    return f"{value:,.{digits}f} [{low:,.{digits}f}, {high:,.{digits}f}]"


def test_methods_have_the_figures_of_their_tables(data: Path, tmp_path: Path, registry: Registry):
    assert "(v2/methods.csv)" in page(tmp_path)
    same = [figure(100), figure(100), figure(80), figure(80), figure(20)]
    shares = ["100.0% [100.0%, 100.0%]", "0.0% [0.0%, 0.0%]"]
    headings, *rows = beside(tmp_path, "methods.csv")
    assert headings[:4] == ["task", "split", "method", "seeds"]
    earned = {row[2]: row[3:] for row in rows}
    assert [*earned] == ["ppo", "random", "sac"] and len(rows) == 3  # no `ppo-mirror`
    assert earned["ppo"] == ["2", *same, *shares]
    # Of SAC's three episodes with a test partner the first two, 40 and 40, are violations.
    assert earned["sac"][3:5] == [figure(50), figure(50)]
    assert earned["sac"][6:] == ["33.3% [33.3%, 33.3%]", "66.7% [66.7%, 66.7%]"]
    assert earned["random"][0] == "1"


def test_the_split_costs_a_fifth(data: Path, tmp_path: Path, registry: Registry, split: Split):
    page(tmp_path)
    name = f"{split.id.split('/')[1]} (default)"
    counts = [str(len(split.train)), str(len(split.test))]
    earned = [figure(100), figure(80), figure(20), "20.0% [20.0%, 20.0%]"]
    assert row(tmp_path, "splits.csv", name) == ["half", *counts, "–", *earned]


def test_all_pairs_of_methods_are_compared(data: Path, tmp_path: Path, registry: Registry):
    page(tmp_path)
    least = 2 / 2001
    rows_shown = {
        name: row(tmp_path, "differences.csv", name)
        for name in ("ppo - random", "ppo - sac", "random - sac")
    }
    for name, value in zip(rows_shown, (75, 30, -45), strict=True):
        better = "100%" if value > 0 else "0%"
        assert rows_shown[name] == [figure(value), better, f"{least:.3f}", f"{3 * least:.3f}"]


def test_in_short_only_trained_methods_come_apart(
    data: Path, tmp_path: Path, registry: Registry, split: Split
):
    # Told what its partner likes: 10 more in one of three episodes.
    put_method(data, split, "ppo-told", {"train": [100, 100, 100], "test": [70, 110, 70]})
    # This one is as good as PPO with every partner, and so not apart from it.
    put_method(data, split, "ppo-gru", {"train": [100, 100, 100], "test": [70, 100, 70]})
    lost, apart, alike, knowing, memory = cells(page(tmp_path), "gentle scratch", "In short")
    assert (lost, memory) == ("20.0% [20.0%, 20.0%]", figure(25))
    assert set(apart.split("; ")) == {"`ppo` > `sac`", "`ppo-gru` > `sac`"}
    assert alike == "`ppo`, `ppo-gru`"
    assert knowing.startswith(figure(-10 / 3) + ", p 0.0")


def test_the_recurrent_robot_adapts(data: Path, tmp_path: Path, registry: Registry):
    page(tmp_path)
    gru = row(tmp_path, "series.csv", "ppo-gru")
    assert gru == ["2", figure(70), figure(85), figure(95), figure(25)]
    assert row(tmp_path, "series.csv", "ppo")[-1] == figure(0)


def test_the_population_has_the_registrys_figures(tmp_path: Path, registry: Registry):
    page(tmp_path)
    kinds = ("IPPO, 20 M", "IPPO, 4 M", "MASAC, 4.16 M", "MASAC, 4.28 M")
    headings = beside(tmp_path, "population.csv")[0]
    assert headings == ["task", "setting", *(f"{kind} steps" for kind in kinds)]
    d1 = row(tmp_path, "population.csv", "d1")
    # Of 100, 101, 102 and 103 a quarter is cut at either end.
    assert d1[0].startswith("4: 101.5 [")
    assert d1[1:] == ["1: 60.0", f"2: {figure(40)}", "1: 99.0"]
    assert row(tmp_path, "population.csv", "d9") == ["–", "–", f"2: {figure(10)}", "–"]
    assert row(tmp_path, "population.csv", "all")[2].startswith("4: 25.0 [")
    # The algorithms share about 4 M steps, and d1 alone.
    assert beside(tmp_path, "equal-steps.csv")[1:] == [
        ["gentle scratch", "4 M", "IPPO", "d1", "1", "60.0", "60.0"],
        ["gentle scratch", "4 M", "MASAC", "d1", "2", figure(40), figure(40)],
    ]


def test_what_is_not_there_is_said_so(
    data: Path, tmp_path: Path, registry: Registry, capfd: pytest.CaptureFixture[str]
):
    text = page(tmp_path)
    message = capfd.readouterr().err
    assert "not measured yet: cross-play of gentle_scratch" in message
    assert "not measured yet: ppo-gru-series on gentle_bath" in message
    assert "ppo on gentle_scratch" not in message
    assert text.count("Not measured yet.") == 1  # diversity
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({line.count(" | ") for line in block.splitlines()}) == 1


def test_minutes_and_commands(data: Path, tmp_path: Path, registry: Registry, split: Split):
    trained = trained_egos(tmp_path / "run", split=split.id)
    tables.write_json({"command": "assistax-zoo train-ego"}, trained / "run.json")
    assert run(["collect", str(trained), "--as", "ppo-gru", "--out", str(data)]) == 0
    text = page(tmp_path)
    name = split.id.split("/")[1]
    minutes = {row[0]: row[1:] for row in beside(tmp_path, "minutes.csv")}
    assert minutes[f"evaluation of sac egos, {name}"][1:] == ["H200", "fused", "1.5"]
    made = minutes[f"training ppo-gru egos, {name}"]
    assert made == ["1 ego, 5 M steps each", "cpu", "fused", "1.5"]
    commands = (tmp_path / "v2" / "commands.txt").read_text().splitlines()
    assert {"assistax-zoo train-ego", "assistax-zoo evaluate ppo-series"} <= {*commands}
    assert text.endswith(f"--data {data} --out {tmp_path / 'page.md'}\n```\n")


def test_check_finds_a_changed_table(
    data: Path, tmp_path: Path, registry: Registry, capfd: pytest.CaptureFixture[str]
):
    page(tmp_path, "--check", code=1)
    assert "does not exist" in capfd.readouterr().err
    good = page(tmp_path)
    assert page(tmp_path, "--check") == good
    [path] = data.glob(f"egos/{TASK}/*/sac/pairs.parquet")
    pairs = tables.read_parquet(path)
    tables.write_parquet(pairs.with_columns(pl.col("return") + pl.lit(0.1, pl.Float32)), path)
    capfd.readouterr()
    assert page(tmp_path, "--check", code=1) == good
    assert "is not what the tables give: line" in capfd.readouterr().err
    tables.write_parquet(pairs, path)
    page(tmp_path, "--check")
    (tmp_path / "v2" / "methods.csv").write_text("changed")
    page(tmp_path, "--check", code=1)
    assert "methods.csv is not what the tables give: line 1" in capfd.readouterr().err


def without_a_partner(data: Path, split: Split) -> None:
    [path] = data.glob(f"egos/{TASK}/*/sac/pairs.parquet")
    pairs = tables.read_parquet(path)
    tables.write_parquet(pairs.filter(pl.col("partner_team") != split.test[0]), path)


def on_other_sides(data: Path, split: Split) -> None:
    exchanged = split.model_copy(update={"train": split.test, "test": split.train})
    put_method(data, exchanged, "sac", {"train": [1], "test": [1]})


def on_another_split(data: Path, split: Split) -> None:
    other = split.model_copy(update={"id": f"{TASK}/half-s9-v2"})
    put_method(data, other, "sac", {"train": [1], "test": [1]})


def with_other_preferences(data: Path, split: Split) -> None:
    put_method(data, split, "sac", {"train": [60, 60], "test": [40, 40]})


def of_another_release(data: Path, split: Split) -> None:
    put_method(data, split, "sac", {"train": [60], "test": [40]}, release="v1")


def without_a_pair(data: Path, split: Split) -> None:
    [path] = data.glob(f"egos/{TASK}/*/sac/pairs.parquet")
    pairs = tables.read_parquet(path)
    gone = (pl.col("partner_team") == split.test[0]) & (pl.col("ego_seed") == 1)
    tables.write_parquet(pairs.filter(~gone), path)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (without_a_partner, "with other test partners"),
        (on_other_sides, "with other train partners|with other test partners"),
        (on_another_split, "not a split of the release"),
        (with_other_preferences, "played other preferences"),
        (of_another_release, "of release v1"),
        (without_a_pair, "pairs on gentle_scratch is not there"),
    ],
)
def test_tables_that_do_not_fit_are_refused(
    data: Path,
    tmp_path: Path,
    split: Split,
    capfd: pytest.CaptureFixture[str],
    spoil: Any,
    message: str,
):
    spoil(data, split)
    assert page(tmp_path, code=1) == ""
    error = capfd.readouterr().err
    assert re.search(message, error), error
    assert "Traceback" not in error


@pytest.fixture
def crossplay(tmp_path: Path, split: Split) -> Path:
    """A cross-play in which every team earns 900 with itself, and 600 with another."""
    return played(tmp_path, split, 600 + 300 * np.eye(len(TEAMS)))


def played(tmp_path: Path, split: Split, matrix: np.ndarray) -> Path:
    """Write the finished cross-play of all teams, with these returns."""
    returns = matrix[:, :, None].repeat(2, axis=2)
    table = episodes(split, returns, TEAMS, likes=("p1", "p5")).with_columns(
        side=pl.lit(None, pl.String), robot_travel=pl.col("partner").rank("dense").cast(pl.Float32)
    )
    folder = tmp_path / "xp"
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    context = dataclasses.replace(CONTEXT, task=TASK, release="v2", split=None)
    derived.save_crossplay(Record(table, folder), context)
    tables.write_json({"command": "assistax-zoo crossplay"}, folder / tables.RUN_FILE)
    return sealed(folder)


def test_a_cross_play_is_drawn_and_its_diversity_told(
    crossplay: Path, tmp_path: Path, registry: Registry, capfd: pytest.CaptureFixture[str]
):
    assert run(["collect", str(crossplay), "--out", str(tmp_path / "v2")]) == 0
    text = page(tmp_path)
    count = len(TEAMS)
    row = cells(text, "gentle scratch", "Cross-play")
    assert row[:3] == [str(count), figure(900), figure(600)]
    assert row[3].startswith("33.3%")
    # 300 times the identity has count - 1 equal directions beside its means; 5 of 10 teams, 4.
    diverse = cells(text, "v2", "Diversity")
    assert diverse[:2] == ["gentle scratch", str(count)]
    assert diverse[2] == "1.00"  # only how far the robot travels tells the partners apart
    assert diverse[4:] == [f"{count - 1:.2f}", "4.00 [4.00, 4.00]"]
    picture = tmp_path / "images" / "v2" / f"crossplay_{TASK}.png"
    assert picture.stat().st_size > 5000
    assert f'src="images/v2/{picture.name}"' in text
    page(tmp_path, "--check")
    picture.unlink()
    page(tmp_path, "--check", code=1)
    assert f"lacks {picture.name}" in capfd.readouterr().err


def test_the_better_convention_is_held_out(tmp_path: Path, split: Split, registry: Registry):
    few = np.isin(np.arange(len(TEAMS)), (0, 3, 8))
    # Robots suit their own group; what each human earns in the mean says nothing of it.
    matrix = 50.0 * (few[:, None] == few) * (1 + np.arange(len(TEAMS))) - 1000 * (np.arange(10) % 2)
    matrix += 2000 * (few[:, None] & few)
    rng = np.random.default_rng(0)
    collect(played(tmp_path, split, matrix + rng.normal(size=matrix.shape)), tmp_path / "v2")
    words = ["cluster", TASK, "--release", "v2", "--data", str(tmp_path / "v2")]
    assert run([*words, "--registry", str(registry.path)]) == 0
    [custom] = [split for split in load_registry(registry.path).splits if split.rule == "custom"]
    assert custom.test == tuple(sorted(team_id(TEAMS[place]) for place in (0, 3, 8)))
    assert len(custom.train) == len(TEAMS) - 3
    words += ["--held-out", "masac", "--test-preferences", "p1,p5", "--default"]
    assert run([*words, "--registry", str(registry.path)]) == 0
    harder = load_registry(registry.path).split(TASK)
    assert harder.test == (team_id(TEAMS[8]),)
    assert harder.train == tuple(sorted(team_id(TEAMS[place]) for place in (1, 2, 4)))
    assert harder.preferences["test"] == ("p1", "p5")


def test_choices_of_teams_keep_rows_columns_and_features_together(
    crossplay: Path, tmp_path: Path, registry: Registry
):
    collect(crossplay, tmp_path / "v2")
    played = read_results(registry, "v2", tmp_path / "v2").crossplay[TASK]
    spread = measures.diversity(played, len(TEAMS))
    # A choice of all teams is the whole, in whatever order.
    assert spread.chosen_returns.value == pytest.approx(spread.returns) == len(TEAMS) - 1
    assert spread.chosen_behaviour.value == pytest.approx(spread.behaviour)
    with pytest.raises(ValueError, match="the cross-play has"):
        measures.diversity(played, len(TEAMS) + 1)
