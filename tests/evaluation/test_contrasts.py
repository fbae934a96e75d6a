"""Contrasts of a file that was written before the test side was played."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from assistax_base.digest import sha256
from assistax_base.errors import FormatError
from assistax_zoo.comparing import compare_named
from assistax_zoo.shell.main import run
from evaluation.figures.contrasts import Pair, contrast_figures, named_pairs, read_contrasts
from evaluation.figures.metrics.inference import mean_test
from evaluation.figures.saved_tables import save_evaluation
from evaluation.record import tables
from evaluation.record.record import Record
from tests.evaluation.episode_tables import CONTEXT, episode_table, recorded, team_id, teams

SPLIT = "scratch-half-v0"  # of CONTEXT
TEAMS = [f"{team_id(team)}/human" for team in teams(4)]
NAMED = "schema = 1\nalpha = 0.05\n" + "".join(
    f"""
[[contrasts]]
task = "scratch"
split = "{SPLIT}"
method = "{method}"
baseline = "ppo"
seeds = 4
"""
    for method in ("gru", "sac")
)


def method(folder: Path, shift: float, seed: int, seeds: int = 4, **context: str) -> Path:
    """An evaluation of a method's seeds with 12 partners, `shift` above that of shift 0."""
    partners = np.random.default_rng(0).normal(500, 80, (1, 12, 2))
    returns = partners + np.random.default_rng(seed).normal(shift, 10, (seeds, 12, 2))
    names = [f"{folder.name}-{place}" for place in range(seeds)]
    table = episode_table(returns, names, teams(12), ["test", "test", "train"] * 4)
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    save_evaluation(Record(table, folder), dataclasses.replace(CONTEXT, **context))
    return folder


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("rows")
    shifts = {"ppo": 0.0, "gru": 50.0, "sac": 0.0, "own": 30.0}
    named = enumerate(shifts.items(), 1)
    return {name: method(root / name, shift, seed) for seed, (name, shift) in named}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "contrasts.toml").write_text(NAMED)
    return tmp_path / "contrasts.toml"


def test_named_contrasts_are_tested_together(rows: dict[str, Path], file: Path) -> None:
    figures = compare_named(file, [rows[name] for name in ("ppo", "gru", "sac")])
    gru, sac = figures.contrasts
    assert (gru.found, sac.found) == (True, False) and gru.named and sac.named
    assert gru.difference.mean == pytest.approx(50, abs=6)
    ends = gru.difference.mean_ci
    assert ends is not None and ends[0] < gru.difference.mean < ends[1]
    assert gru.p_holm == pytest.approx(min(1.0, 2 * gru.p)) and sac.p_holm == sac.p
    assert 0 < gru.detectable < gru.detectable_holm < 50
    assert (gru.seeds, gru.partners) == ((4, 4), 8)  # the test side alone
    assert figures.sha256 == sha256(file.read_bytes())


def test_a_leagues_folder_stands_for_its_rows(rows: dict[str, Path], file: Path, capfd) -> None:
    league = shutil.copytree(rows["ppo"].parent, file.parent / "league")
    (league / "runs" / "ppo").mkdir(parents=True)  # what `tools.league row` writes beside rows
    assert compare_named(file, [league]) == compare_named(file, [league / row for row in rows])
    assert run(["compare", str(league), "--contrasts", str(file)]) == 0
    assert "gru - ppo" in capfd.readouterr().out
    method(league / "gru" / "sac", 0.0, 9)  # in an evaluation, and no row
    contrasts = compare_named(file, [league / "ppo", league / "gru"]).contrasts
    assert [contrast.method for contrast in contrasts] == ["gru"]
    with pytest.raises(FileNotFoundError, match=r"runs/summary\.json"):
        compare_named(file, [league / "runs"])


def test_fewer_seeds_than_named_are_another_contrast(rows: dict[str, Path], file: Path) -> None:
    file.write_text(NAMED.replace("seeds = 4", "seeds = 8", 1))
    gru, sac = compare_named(file, [rows[name] for name in ("ppo", "gru", "sac")]).contrasts
    assert (gru.named, gru.p_holm, gru.found) == (False, None, None)
    assert sac.named and sac.p_holm == pytest.approx(min(1.0, 2 * sac.p))
    words = "4 and 4 seeds, and 8 of either were named; counts as p = 1"
    assert words in compare_named(file, [rows["ppo"], rows["gru"]]).notes[0]


def test_the_method_with_fewer_seeds_decides(
    rows: dict[str, Path], file: Path, tmp_path: Path
) -> None:
    """Eight seeds of PPO do not make up for four of the method, though eight were named."""
    file.write_text(NAMED.replace("seeds = 4", "seeds = 8", 1))
    ppo = method(tmp_path / "ppo", 0.0, 1, seeds=8)
    [gru] = compare_named(file, [ppo, rows["gru"]]).contrasts
    assert (gru.seeds, gru.difference.seeds, gru.named) == ((4, 8), (4, 8), False)


def test_the_figures_are_those_of_the_test_side(rows: dict[str, Path], file: Path) -> None:
    gru = compare_named(file, [rows["ppo"], rows["gru"]]).contrasts[0]
    sides = [Record.read(rows[name]).returns.evaluated_side for name in ("gru", "ppo")]
    assert gru.p == mean_test(*(side.scores for side in sides)).p
    assert gru.difference.means == pytest.approx([side.values.mean() for side in sides])
    assert gru.difference.partners == gru.partners == 8


def test_teams_count_beside_persons_as_one_group(file: Path) -> None:
    """Of differences with means 2, 6 and 25 in three groups; the mean of all partners is 14.5."""
    partners = [(family, "own", n) for family in ("spring", "stepper") for n in (0, 1)]
    differences = np.array([1.0, 3, 4, 8, 10, 20, 30, 40])[None, :, None]
    gru, ppo = (
        recorded(episode_table(returns, [name], [*partners, *teams(4)], ["test"] * 8))
        for name, returns in (("gru", 500.0 + differences), ("ppo", np.full((1, 8, 1), 500.0)))
    )
    named, digest = read_contrasts(file)
    pairs = {("scratch", "gru", "ppo"): Pair(gru, ppo, SPLIT)}
    [found] = contrast_figures(named, digest, "file", pairs).contrasts
    assert (found.difference.mean, found.partners) == (pytest.approx(11.0), 8)
    parts = np.array([2 / 2, 8 / 2, 500 / 3 / 4]) / 9  # variances of the groups' means, over 3^2
    freedom = parts.sum() ** 2 / (parts**2 / [1, 1, 3]).sum()
    assert found.p == pytest.approx(2 * stats.t.sf(11 / np.sqrt(parts.sum()), freedom))
    alone = {("scratch", "gru", "ppo"): Pair(*(r.without(TEAMS) for r in (gru, ppo)), SPLIT)}
    [found] = contrast_figures(named, digest, "file", alone).contrasts
    assert found.difference.mean == pytest.approx(4.0)
    assert found.p == pytest.approx(stats.ttest_1samp([1, 3, 4, 8], 0).pvalue), "persons as before"


def test_unnamed_methods_are_paired_too(file: Path) -> None:
    named, _ = read_contrasts(file)
    both = [(task, method) for task in ("bed_bath", "scratch") for method in ("gru", "ppo")]
    assert named_pairs(named, [*both, ("bed_bath", "told-preference")]) == [
        ("bed_bath", "gru", "ppo"),
        ("scratch", "gru", "ppo"),
    ]


def test_unnamed_contrast_is_marked(rows: dict[str, Path], file: Path) -> None:
    figures = compare_named(file, list(rows.values()))
    own = figures.contrasts[-1]
    assert (own.method, own.named, own.p_holm, own.found) == ("own", False, None, None)
    words = "own less ppo on scratch, return: not named in contrasts.toml"
    assert any(words in note for note in figures.notes)
    named = compare_named(file, [rows[name] for name in ("ppo", "gru", "sac")])
    assert [c.p_holm for c in figures.contrasts[:2]] == [c.p_holm for c in named.contrasts]


def test_missing_contrast_counts_in_correction(rows: dict[str, Path], file: Path) -> None:
    figures = compare_named(file, [rows["ppo"], rows["sac"]])
    assert figures.missing == ("gru less ppo on scratch, return",)
    assert figures.contrasts[0].p_holm == pytest.approx(min(1.0, 2 * figures.contrasts[0].p))


def test_unfit_folders_of_contrasts_are_refused(
    rows: dict[str, Path], file: Path, tmp_path: Path
) -> None:
    again = method(tmp_path / "again" / "ppo", 0.0, 9)
    with pytest.raises(ValueError, match="are both ppo on scratch"):
        compare_named(file, [rows["ppo"], again])
    both = [rows["ppo"], rows["gru"]]
    file.write_text(NAMED.replace(SPLIT, "scratch/other"))
    with pytest.raises(ValueError, match=r"played on split scratch-half-v0, and contrasts\.toml"):
        compare_named(file, both)
    file.write_text(NAMED.replace("seeds = 4", 'metric = "violations"\nseeds = 4'))
    with pytest.raises(ValueError, match="tables of this task have no violations; name return"):
        compare_named(file, both)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("schema = 1", "schema = 2", "schema is 2"),
        ("alpha = 0.05", "alpha = 1.5", "alpha is 1.5"),
        ("seeds = 4", "seed = 4", "seeds is missing"),
        ('method = "sac"', 'method = "gru"', "is named twice"),
        ('method = "sac"', 'method = "ppo"', "not tested against itself"),
        ("schema = 1", "schema = = 1", "TOMLDecodeError"),
    ],
)
def test_malformed_contrasts_file_gets_one_line(file: Path, old: str, new: str, words: str) -> None:
    file.write_text(NAMED.replace(old, new))
    with pytest.raises(FormatError, match=words):
        read_contrasts(file)


def test_the_command_prints_hash_and_verdicts(
    rows: dict[str, Path], file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["compare", *map(str, rows.values()), "--contrasts", str(file)]
    assert run(words) == 0
    printed = capfd.readouterr().out
    assert f"sha256 {sha256(file.read_bytes())}" in printed and "not named" in printed
    assert "4 and 4 seeds, 8 partners" in " ".join(printed.split())
    assert run([*words, "--json"]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert [c["found"] for c in answer["contrasts"]] == [True, False, None]
    assert run(["compare", str(rows["ppo"])]) == 1
    assert "1 folder to compare; give two" in capfd.readouterr().err
