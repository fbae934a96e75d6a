"""The results page: planted populations give the verdicts they should; the page is up to date."""

import dataclasses
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.figures import saved_tables as derived
from evaluation.figures import summary
from evaluation.figures.saved_tables import pair_table
from evaluation.figures.strategies import summarise_strategies
from evaluation.record import tables
from evaluation.record.record import Record
from population.networks.spec import PolicySpec
from tests.evaluation.episode_tables import (
    CONTEXT,
    Team,
    clustered_matrix,
    episode_table,
    recorded,
    sealed,
    team_id,
    teams,
)
from tests.zoo.conftest import SPECS, put, random_params, trained_team
from tools.release_page.__main__ import run
from tools.release_page.collect import collect
from tools.release_page.data import CrossPlayed
from tools.release_page.paper import measures
from tools.release_page.paper.claims import Claim, Criterion, check_claims
from tools.release_page.paper.data import Egos, Results, read_notes, read_paper, read_results
from tools.release_page.paper.figures import figures
from tools.release_page.paper.measures import probability_of_improvement
from tools.release_page.paper.page import make_page
from tools.release_page.paper.page import tables as page_tables
from zoo.parameters.storage import write_policy_file
from zoo.registry import Registry
from zoo.schema import PolicyEntry, SelfPlay, Training

pytestmark = pytest.mark.slow  # the pages of a release that stays as it is

ROOT = Path(__file__).parents[2]
POPULATION = teams(20)
PUBLISHED: list[Team] = [
    (a, d, s) for a in ("ippo", "masac") for d in ("d1", "d9") for s in range(3)
]
SEEDS, PARTNERS = 6, 20


# Matrices with known answers


def blocks(count: int = 20, across: float = 0.4) -> np.ndarray:
    """Two groups that fit each other only within: 900 there, a share of it across."""
    group = np.arange(count) % 2
    noise = np.random.default_rng(0).normal(0, 10, (count, count))
    return np.where(group[:, None] == group[None], 900.0, 900.0 * across) + noise


def additive(robots: float, humans: float, count: int = 20, noise: float = 10.0) -> np.ndarray:
    """No strategies: robots and humans are better or worse by exactly these deviations."""
    rng = np.random.default_rng(1)
    quality = rng.normal(size=(2, count))
    quality = (quality - quality.mean(axis=1, keepdims=True)) / quality.std(axis=1, keepdims=True)
    means = 900 + robots * quality[0][:, None] + humans * quality[1][None]
    return means + rng.normal(0, noise, (count, count))


def poor_half(count: int = 20) -> np.ndarray:
    """Return = robot's quality x human's: half of the teams are poor, none is incompatible."""
    quality = np.where(np.arange(count) % 2, 1.0, 0.3)
    return 900 * quality[:, None] * quality[None] + np.random.default_rng(2).normal(
        0, 10, (count, count)
    )


def test_incompatible_pairs_are_counted():
    assert measures.incompatible_share(blocks()) == pytest.approx(200 / 380)
    assert measures.incompatible_share(blocks(across=0.6)) == 0
    one_way = np.array([[10.0, 1.0], [9.0, 10.0]])
    assert measures.incompatible_share(one_way) == 0.5
    assert measures.incompatible_share(np.array([[10.0, 1.0], [1.0, 10.0]])) == 1


def test_poor_teams_are_not_taken_for_incompatible_ones():
    for matrix in (poor_half(), additive(300, 0), additive(0, 300)):
        assert measures.incompatible_share(matrix) < 0.02
        assert measures.largest_exchange_loss(matrix, permutations=1).loss < 0.1


def test_incompatible_groups_are_found():
    loss = measures.largest_exchange_loss(blocks(120), permutations=39)
    assert loss.loss == pytest.approx(0.6, abs=0.02)
    assert [set(group % 2) for group in sorted(loss.groups, key=lambda group: group[0] % 2)] == [
        {0},
        {1},
    ]
    assert loss.p == pytest.approx(1 / 40)
    assert loss.null < 0.3
    one_way = blocks()
    one_way[0::2, 1::2] = 890.0  # the robots of the first half play well with every human
    assert measures.largest_exchange_loss(one_way, permutations=1).loss < 0.05


def test_a_few_outliers_are_no_group():
    """Of 60 teams two lose with all others: less than a twentieth."""
    matrix = additive(10, 10, count=60)
    matrix[:2, 2:] = matrix[2:, :2] = 100.0
    assert measures.largest_exchange_loss(matrix, permutations=1).loss < 0.1
    matrix[:4, 4:] = matrix[4:, :4] = 100.0
    matrix[:4, :4] = 900.0
    loss = measures.largest_exchange_loss(matrix, permutations=1)
    assert loss.loss > 0.8
    assert {bool(set(group) <= {0, 1, 2, 3}) for group in loss.groups} == {True, False}


def test_loss_without_groups_is_chance():
    chance = [
        measures.largest_exchange_loss(additive(200, 200 * i), permutations=39).p for i in range(4)
    ]
    assert min(chance) > 0.05
    alone = additive(50, 50) + 500 * np.eye(20)  # self-play
    assert measures.largest_exchange_loss(alone, permutations=39).p > 0.05
    assert measures.largest_exchange_loss(np.ones((3, 3)), permutations=1).groups == ()


def test_variance_is_split_between_robots_and_humans():
    for robots, humans in ((100, 0), (0, 100), (100, 100)):
        shares = measures.variance_shares(
            additive(robots, humans, count=60, noise=1) + 400 * np.eye(60)
        )
        total = robots**2 + humans**2
        assert shares.robot.value == pytest.approx(robots**2 / total, abs=0.02)
        assert shares.human.value == pytest.approx(humans**2 / total, abs=0.02)
        assert shares.robot.value + shares.human.value + shares.rest.value == pytest.approx(1)
        assert shares.rest.value < 0.01
        assert shares.human.value_ci is not None
        assert shares.human.value_ci[0] - 0.01 < shares.human.value <= shares.human.value_ci[1]
    assert measures.variance_shares(blocks(60)).rest.value > 0.95


def test_improvement_interval_is_that_of_plain_resampling():
    rng = np.random.default_rng(4)
    x, y = rng.normal(0.4, 1, (5, 7)), rng.normal(0, 1, (4, 7))
    draws, columns = [], []
    for _ in range(3000):
        a, b, c = rng.integers(0, 5, 5), rng.integers(0, 4, 4), rng.integers(0, 7, 7)
        draws.append(probability_of_improvement(x[a][:, c], y[b][:, c]))
    for _ in range(3000):
        a, b = rng.integers(0, 5, (5, 7)), rng.integers(0, 4, (4, 7))
        drawn = np.take_along_axis(x, a, 0), np.take_along_axis(y, b, 0)
        columns.append(probability_of_improvement(*drawn))
    for stratified, expected in ((False, draws), (True, columns)):
        found = measures.improvement(x, y, stratified=stratified, resamples=3000)
        assert found.value == probability_of_improvement(x, y) and found.value_ci is not None
        interval = np.quantile(expected, (0.025, 0.975))
        np.testing.assert_allclose(found.value_ci, interval, atol=0.02)
        assert measures.improvement(x + 99, y, stratified=stratified).value_ci == (1, 1)


def test_relative_gap():
    sides = ["train", "test"] * 5
    scores = np.where(np.array(sides) == "train", 100.0, 80.0) + np.arange(4)[:, None]
    gap = measures.relative_gap(scores, sides)
    assert gap.value == pytest.approx(20 / 101.5)
    assert gap.value_ci is not None and gap.value_ci[0] <= gap.value <= gap.value_ci[1]


# Claims


def played(matrix: np.ndarray, population: list[Team] = POPULATION) -> CrossPlayed:
    table = episode_table(matrix[:, :, None], population, population)
    pairs, order = derived.crossplay_matrix(recorded(table))
    content = tables.to_json(summary.summarise_crossplay(recorded(table), CONTEXT))
    run = {"command": "assistax-zoo crossplay", "seconds": 60.0, "devices": ["cpu"]}
    return CrossPlayed(pairs, order, summarise_strategies(pairs), content, run)


def egos(train: float, test: float, spread: float = 5.0) -> Egos:
    sides = ["train", "test"] * (PARTNERS // 2)
    means = np.where(np.array(sides) == "train", train, test)
    returns = means + np.random.default_rng(5).normal(0, spread, (SEEDS, PARTNERS))
    names = [f"ppo-s{seed}.safetensors" for seed in range(SEEDS)]
    table = episode_table(np.repeat(returns[:, :, None], 2, axis=2), names, teams(PARTNERS), sides)
    pairs = pair_table(recorded(table)).with_columns(
        pl.Series("ego_seed", np.repeat(np.arange(SEEDS), PARTNERS))
    )
    content = tables.to_json(summary.summarise_evaluation(recorded(table), CONTEXT))
    return Egos(pairs, content, {"command": "assistax-zoo evaluate", "seconds": None}, None)


def humans(
    returns: dict[str, list[float]], task: str = "scratch", disability: str = "d1"
) -> list[PolicyEntry]:
    covered = []
    setting = DISABILITY_SETTINGS[disability]
    facts = {"steps": 10_000_000, "env_version": 1, "backend": "native", "device": "cpu"}
    for algorithm, means in returns.items():
        for seed, mean in enumerate(means):
            team = f"{task}/{algorithm}-{disability}-s{seed}-v0"
            own = SelfPlay(mean=mean, iqm=mean, mean_ci=(mean - 1, mean + 1), n=16)
            names = f"{team}/human", team, task, algorithm, "human", disability, setting, seed, "v0"
            row = PolicySpec("human", 38, 3), "shard", seed, "0" * 64, f"{task}-{algorithm}"
            covered.append(PolicyEntry(*names, *row, Training(**facts, seconds=30.0), own))
    return covered


def results(**changes: Any) -> Results:
    empty = Results("v0", [], None, {}, {}, read_paper(), {})
    return dataclasses.replace(empty, **changes)


def verdict(release: Results, title: str) -> str:
    """Return the verdict of a claim, of the task that has one."""
    verdicts = {claim.verdict for claim in check_claims(release) if title in claim.title}
    return (verdicts - {"not measured yet"} or verdicts).pop()


def met(**robots: Egos) -> Results:
    """Return a release with robots of scratch."""
    return results(egos={("scratch", name): ego for name, ego in robots.items()})


def alone(**returns: list[float]) -> Results:
    """Return a release with humans of scratch."""
    return results(humans=humans(returns))


def crossed(matrix: np.ndarray, task: str = "arm_assist") -> Results:
    return results(crossplay={task: played(matrix, teams(len(matrix)))})


def test_nothing_is_claimed_of_what_was_not_measured():
    claims = check_claims(results())
    assert len(claims) == 18
    assert {claim.verdict for claim in claims} == {"not measured yet"}


RISING = {"ippo": [930.0, 940, 950, 960], "mappo": [600.0, 700, 800, 900]}
RISING["masac"] = [650.0, 700, 750, 800]
FALLING = {"ippo": [100.0, 200, 300], "masac": [650.0, 700, 750]}


@pytest.mark.parametrize(
    ("title", "release", "expected"),
    [
        ("incompatible", lambda: crossed(blocks(), "scratch"), "holds"),
        # Clusters lose a third, but no pair falls below one half.
        ("incompatible", lambda: crossed(blocks(across=0.65), "scratch"), "holds in part"),
        ("incompatible", lambda: crossed(blocks(across=0.65), "bed_bath"), "holds in part"),
        ("incompatible", lambda: crossed(additive(60, 60), "bed_bath"), "does not hold"),
        ("incompatible", lambda: crossed(additive(300, 0), "scratch"), "does not hold"),
        ("contributes", lambda: crossed(additive(200, 10)), "holds"),
        ("contributes", lambda: crossed(additive(250, 130, count=60)), "holds in part"),
        ("contributes", lambda: crossed(additive(10, 200)), "does not hold"),
        ("contributes", lambda: crossed(blocks()), "does not hold"),
        ("contributes", lambda: crossed(additive(100, 100)), "undecided"),
        ("gap, PPO", lambda: met(ppo=egos(800, 795)), "holds"),
        ("gap, PPO", lambda: met(ppo=egos(800, 500)), "does not hold"),
        ("gap, PPO", lambda: met(ppo=egos(500, 800)), "does not hold"),
        ("gap, PPO", lambda: met(ppo=egos(800, 720, spread=60.0)), "undecided"),
        ("gap, SAC", lambda: met(ppo=egos(800, 795)), "not measured yet"),
        ("PPO egos above", lambda: met(ppo=egos(800, 790), sac=egos(700, 690)), "holds"),
        ("PPO egos above", lambda: met(ppo=egos(700, 690), sac=egos(800, 790)), "does not hold"),
        ("PPO egos above", lambda: met(ppo=egos(800, 790), sac=egos(800, 790)), "undecided"),
        ("IPPO above", lambda: alone(**RISING), "holds"),
        ("MAPPO above", lambda: alone(**RISING), "undecided"),
        ("IPPO above", lambda: alone(**FALLING), "does not hold"),
        ("MAPPO above", lambda: alone(**FALLING), "not measured yet"),
    ],
)
def test_planted_release_gets_its_verdict(
    title: str, release: Callable[[], Results], expected: str
):
    assert verdict(release(), title) == expected


def test_egos_that_met_other_partners_are_not_compared():
    other = egos(800, 790)
    other = dataclasses.replace(other, pairs=other.pairs.with_columns(pl.col("side").reverse()))
    with pytest.raises(ValueError, match="different partners"):
        check_claims(met(ppo=egos(800, 790), sac=other))


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        (("met", "met"), "holds"),
        (("met", "not met"), "does not hold"),
        (("not met", "met"), "holds in part"),
        (("undecided", "met"), "undecided"),
        (("met", "undecided"), "undecided"),
        (("not met", "undecided"), "undecided"),
    ],
)
def test_verdict_of_mixed_criteria(outcomes: Any, expected: str):
    criteria = [Criterion("w", "v", "t", outcome) for outcome in outcomes]
    assert Claim("c", "scratch", "f", criteria).verdict == expected


# Collecting


@pytest.fixture
def crossplay_folder(tmp_path: Path) -> Path:
    table = episode_table(
        np.repeat(clustered_matrix(12, 2)[:, :, None], 2, axis=2), PUBLISHED, PUBLISHED
    )
    folder = tmp_path / "xp"
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    derived.save_crossplay(Record(table, folder), CONTEXT)
    command = "assistax-zoo crossplay --egos 'scratch/*' --lock=/mnt/a.lock --out /home/me/xp"
    tables.write_json({"command": command, "devices": ["cpu"]}, folder / "run.json")
    return sealed(folder)


def evaluation_folder(
    tmp_path: Path, method: str, shift: float, sides: tuple[str, str] = ("train", "test")
) -> Path:
    returns = np.random.default_rng(6).normal(500 + shift, 5, (3, 4, 2))
    names = [f"/mnt/runs/{method}/policies/{method}-s{seed}.safetensors" for seed in range(3)]
    table = episode_table(returns, names, PUBLISHED[:4], list(sides) * 2)
    folder = tmp_path / f"evaluated-{method}"
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    derived.save_evaluation(Record(table, folder), CONTEXT)
    command = ["assistax-zoo evaluate --split both", *(f"--policy {name}" for name in names)]
    tables.write_json({"command": " ".join(command)}, folder / "run.json")
    return sealed(folder)


def resealed(folder: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Write another summary into a folder, as if the folder had been written so."""
    tables.write_json(change(tables.read_json(folder / "summary.json")), folder / "summary.json")
    sealed(folder)


def test_a_changed_folder_is_not_collected(crossplay_folder: Path, tmp_path: Path) -> None:
    """Without the manifest's hashes a changed return would enter a release's data."""
    for folder in (crossplay_folder, evaluation_folder(tmp_path, "ppo", 0)):
        table = tables.read_episodes(folder / "episodes.parquet")
        changed = table.with_columns(pl.col("return") * 1.5)
        tables.write_episodes(changed, folder / "episodes.parquet")
        with pytest.raises(ValueError, match=r"expected sha256 .*nothing was collected"):
            collect(folder, tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_a_cross_play_is_condensed_and_read_back(crossplay_folder: Path, tmp_path: Path):
    out = collect(crossplay_folder, tmp_path / "data")
    assert out == tmp_path / "data" / "crossplay" / "scratch"
    names = "order.json pairs.parquet run.json strategies.json summary.json"
    assert sorted(path.name for path in out.iterdir()) == names.split()
    pairs = tables.read_parquet(out / "pairs.parquet")
    assert pairs.height == 144
    assert {pairs.schema[name] for name in ("return", "return_sd", "force_mean")} == {pl.Float32()}
    run = tables.read_json(out / "run.json")
    assert run["command"] == "assistax-zoo crossplay --egos 'scratch/*' --lock=a.lock --out xp"
    assert run["env_steps"] == 288_000
    assert run["seconds"] == pytest.approx(288_000 / (CONTEXT.env_steps_per_second or 1.0))
    again = read_results(published(tmp_path), "v0", tmp_path / "data").crossplay["scratch"]
    places = [[team_id(team) for team in PUBLISHED].index(name) for name in again.teams]
    played_first = clustered_matrix(12, 2)[np.ix_(places, places)]
    np.testing.assert_allclose(again.matrix, played_first, rtol=1e-6)
    assert sorted(place for cluster in again.clusters for place in cluster) == list(range(12))


def test_an_evaluation_is_condensed_under_its_method(tmp_path: Path):
    out = collect(evaluation_folder(tmp_path, "sac", 0), tmp_path / "data")
    assert out.name == "scratch-sac"
    pairs = tables.read_parquet(out / "pairs.parquet")
    assert pairs.select("ego", "ego_algorithm", "ego_seed").unique(maintain_order=True).rows() == [
        (f"sac-s{seed}.safetensors", "sac", seed) for seed in range(3)
    ]
    assert pairs["episodes"].unique().to_list() == [2]
    assert "/mnt" not in "".join(path.read_text() for path in out.glob("*.json"))
    release = read_results(published(tmp_path), "v0", tmp_path / "data")
    scores = release.egos["scratch", "sac"].scores
    whole = Record.read(tmp_path / "evaluated-sac").returns.scores
    np.testing.assert_allclose(np.sort(scores, axis=None), np.sort(whole, axis=None), rtol=1e-6)
    assert scores.shape == (3, 4)


def trained_folder(tmp_path: Path, seeds: int = 1, **changes: Any) -> Path:
    """Return a folder of trained robots."""
    folder = tmp_path / "run" / "policies"
    folder.mkdir(parents=True)
    metadata = {"task": "scratch", "algorithm": "ppo", "training": {}, **changes}
    spec = SPECS["robot"]
    for seed in range(seeds):
        path, params = folder / f"ppo-s{seed}.safetensors", random_params(spec, seed)
        write_policy_file(path, spec, params, {**metadata, "seed": seed})
    return folder.parent


def test_training_of_egos_is_condensed(tmp_path: Path):
    training = {"steps": 5000, "seconds": 90.0, "device": "cpu", "secret": "/home/me"}
    folder = trained_folder(tmp_path, seeds=2, split="half", training=training)
    written = tables.read_json(collect(folder, tmp_path / "data") / "training.json")
    assert written["egos"] == 2
    assert (written["steps"], written["seconds"], written["split"]) == (5000, 90.0, "half")
    assert "secret" not in written


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "summary.json").unlink(), "holds no summary.json"),
        (
            lambda folder: resealed(folder, lambda content: {"task": content["task"]}),
            "neither crossplay nor",
        ),
        (lambda folder: (folder / "strategies.json").unlink(), "strategies.json is missing"),
        (lambda folder: (folder / "manifest.json").unlink(), "has no manifest.json"),
    ],
)
def test_unfinished_folder_is_refused(
    crossplay_folder: Path, tmp_path: Path, spoil: Any, message: str
):
    spoil(crossplay_folder)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        collect(crossplay_folder, tmp_path / "data")


@pytest.mark.parametrize(
    "task", ["../../x", "/tmp/x", "scratch/..", ["scratch"], None, "gentle_bath"]
)
def test_a_received_folder_cannot_write_outside(
    crossplay_folder: Path, tmp_path: Path, task: Any
) -> None:
    """Its summary or its policies name the task, and the task names a folder."""
    data = tmp_path / "a" / "b" / "data"
    evaluated = evaluation_folder(tmp_path, "ppo", 0)
    for folder in (crossplay_folder, evaluated):
        resealed(folder, lambda content: {**content, "task": task})
    trained = trained_folder(tmp_path, task=task)
    before = sorted(tmp_path.rglob("*"))
    for folder in (crossplay_folder, evaluated, trained):
        with pytest.raises(ValueError, match=r"names the task .*allowed are scratch"):
            collect(folder, data)
    with pytest.raises(ValueError, match="names the algorithm"):
        collect(trained_folder(tmp_path / "other", algorithm="../../x"), data)
    shutil.rmtree(tmp_path / "other")
    assert sorted(tmp_path.rglob("*")) == before


def test_one_side_or_several_methods_are_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="--split both"):
        collect(evaluation_folder(tmp_path, "ppo", 0, ("test", "test")), tmp_path / "data")
    folder = evaluation_folder(tmp_path, "sac", 0)
    resealed(folder, lambda content: {**content, "egos": ["zoo:scratch/ippo-d1-s0-v0/robot"]})
    with pytest.raises(ValueError, match="expected the policies of one train-ego run"):
        collect(folder, tmp_path / "data")


# The page


def published(tmp_path: Path) -> Registry:
    return put([trained_team(*team) for team in PUBLISHED], tmp_path / "registry.json")


@pytest.fixture
def words(tmp_path: Path, crossplay_folder: Path) -> list[str]:
    """Data of a partial release, cross-play, egos and curves of scratch; and its page's command."""
    data = tmp_path / "data"
    folders = [evaluation_folder(tmp_path, "ppo", 50), evaluation_folder(tmp_path, "sac", 0)]
    assert run(["collect", *map(str, [crossplay_folder, *folders]), "--out", str(data)]) == 0
    published(tmp_path)
    steps = np.tile(np.arange(1, 101) * 100_000, 3)
    rows = {"seed": np.repeat(np.arange(3), 100), "steps": steps}
    rows["return"] = 1000 * (1 - np.exp(-steps / 2e6))
    names = {"task": "scratch", "algorithm": "ippo", "disability": "d1"}
    curves = pl.DataFrame({**names, **rows})
    tables.write_parquet(curves, data / "curves" / "scratch-ippo.parquet")
    notes = "## self-play\n\nOurs plays its [most](../docs/a.md#b) likely actions.\n\n## zsc\n\n"
    (data / "notes.md").write_text(notes)
    common = ["--release", "v0", "--data", str(data), "--out", str(tmp_path / "page.md")]
    return ["page", *common, "--registry", str(tmp_path / "registry.json")]


def test_the_page_of_a_partial_release(words: list[str], tmp_path: Path, capfd):
    assert run(words) == 0
    text = (tmp_path / "page.md").read_text()
    message = capfd.readouterr().err
    assert "422 of 434 teams of Table 6" in message
    assert "not measured yet: cross-play of bed_bath" in message
    assert "cross-play of scratch" not in message
    assert f"{message.count('warning: ')} warnings" in message
    assert 'v0,scratch,IPPO,"950.5 [' in (tmp_path / "v0" / "self-play.csv").read_text()
    assert "12 of 434 teams" in text
    assert "**Why.** Ours plays its [most](docs/a.md#b) likely actions." in text
    assert text.count("**Why.**") == 1
    assert "and 2 more --policy" in (tmp_path / "v0" / "commands.txt").read_text()
    pictures = [tmp_path / name for name in re.findall(r'src="([^"]+)"', text)]
    expected = "crossplay_scratch.png curves.png population.png zsc_scratch.png"
    assert sorted(picture.name for picture in pictures) == expected.split()
    made = [path.read_bytes() for path in pictures]
    assert min(map(len, made)) > 5000
    assert all(line.count("|") > 2 for line in text.splitlines() if line.startswith("|"))
    assert run(words) == 0  # the same tables give the same page
    assert (tmp_path / "page.md").read_text() == text
    assert [path.read_bytes() for path in pictures] == made


def test_trainings_stand_with_their_minutes_and_commands():
    training = {"egos": 2, "steps": 5e6, "seconds": 90.0, "command": "assistax-zoo train-ego"}
    ego = dataclasses.replace(egos(800, 790), training=training)
    files = page_tables(results(egos={("scratch", "ppo"): ego}))
    row = 'training scratch PPO egos,"2 egos, 5 M steps each",–,–,1.5\n'
    assert row in files["minutes.csv"]
    assert files["commands.txt"] == "assistax-zoo train-ego\nassistax-zoo evaluate\n"


def test_table_rows_have_equal_cells():
    everything = results(
        humans=humans({"ippo": [930.0, 940], "masac": [700.0, 800]}),
        crossplay={task: played(blocks()) for task in ("scratch", "bed_bath", "arm_assist")},
        egos={("scratch", "ppo"): egos(800, 790), ("bed_bath", "sac"): egos(700, 690)},
    )
    for release in (everything, results()):
        page = make_page(release, "images", "make results")
        blocks_of_lines = re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE)
        assert len(blocks_of_lines) >= 4
        for block in blocks_of_lines:
            assert len({line.count(" | ") for line in block.splitlines()}) == 1


def test_check_finds_an_outdated_page(words: list[str], tmp_path: Path, capfd):
    assert run([*words, "--check"]) == 1
    assert "does not exist" in capfd.readouterr().err
    assert run(words) == 0
    assert run([*words, "--check"]) == 0
    page = tmp_path / "page.md"
    good = page.read_text()
    page.write_text(good.replace("12 of 434", "13 of 434", 1))
    assert run([*words, "--check"]) == 1
    message = capfd.readouterr().err
    assert "is not what the tables give: line" in message
    assert "Traceback" not in message
    page.write_text(good)
    (tmp_path / "images" / "v0" / "curves.png").unlink()
    assert run([*words, "--check"]) == 1
    assert "lacks curves.png" in capfd.readouterr().err


def test_tables_of_another_release_are_refused(words: list[str], capfd):
    place = words.index("v0")
    assert run([*words[:place], "v1", *words[place + 1 :]]) == 1
    assert "is of v1; give the data of v1" in capfd.readouterr().err


def test_foreign_partners_are_refused_and_absent_ones_named(
    words: list[str], tmp_path: Path, capfd
):
    registry = tmp_path / "registry.json"
    more, fewer = [*PUBLISHED, ("masac", "d9", 3)], PUBLISHED[1:]
    for population, code, message in (
        (more, 0, "not measured yet: cross-play of scratch for 1 of its 13 teams"),
        (fewer, 1, "1 partners on scratch that are not in release v0, first scratch/ippo-d1-s0-v0"),
    ):
        registry.unlink()
        put([trained_team(*team) for team in population], registry)
        assert run(words) == code
        assert message in capfd.readouterr().err


def test_a_note_on_an_unknown_section_is_refused(tmp_path: Path):
    path = tmp_path / "notes.md"
    path.write_text("intro\n\n## cross-play\n\nBecause.\n\nTwo paragraphs.\n")
    assert read_notes(path) == {"cross-play": "Because.\n\nTwo paragraphs."}
    path.write_text("## crossplay\n\nBecause.\n")
    with pytest.raises(ValueError, match="'crossplay'; allowed are summary"):
        read_notes(path)


def test_population_is_complete_with_every_team_alone():
    whole = [
        human
        for task, kinds in read_paper()["population"].items()
        for name, kind in kinds.items()
        for setting in range(kind["settings"])
        for human in humans({name: [500.0] * kind["seeds"]}, task, f"d{setting + 1}")
    ]
    assert len(whole) == 434
    page = make_page(results(humans=whole), "images", "make results")
    assert "434 of 434 teams. The composition is the paper's." in page
    assert not [name for name in results(humans=whole).missing if "Table 6" in name]
    moved = [dataclasses.replace(whole[0], disability="d2"), *whole[1:]]
    page = make_page(results(humans=moved), "images", "make results")
    assert "Different from the paper's: scratch IPPO." in page


@pytest.mark.parametrize(
    ("mean", "expected"), [(940.0, "agree"), (700.0, "below"), (1100.0, "above")]
)
def test_self_play_beside_the_paper_s(mean: float, expected: str):
    release = results(humans=humans({"ippo": [mean - 1, mean, mean + 1]}))
    lines = page_tables(release)["self-play.csv"].splitlines()
    [line] = [line for line in lines if ",scratch,IPPO," in line]
    assert "939.5 [" in line and line.endswith(f",{expected}")


def test_pictures_are_those_that_the_data_allow():
    release = results(humans=humans({"ippo": [900.0]}), egos={("bed_bath", "sac"): egos(700, 690)})
    drawn = figures(release)
    assert [*drawn] == ["population.png", "zsc_bed_bath.png"]
    assert all(draw().axes for draw in drawn.values())
    assert not figures(results())


def test_committed_page_follows_from_its_tables(monkeypatch, capfd):
    monkeypatch.chdir(ROOT)
    places = "--data docs/data/paper --out docs/log/paper.md --images docs/images/paper"
    words = f"page --release v1 {places} --registry registry.json --check".split()
    assert run(words) == 0, capfd.readouterr().err


def test_committed_tables_name_no_place_of_a_machine():
    for path in (ROOT / "docs" / "data").rglob("*.json"):
        assert not re.search(r"[\" =](/[a-z]+){2,}", json.dumps(json.loads(path.read_text()))), path
