"""Folders are compared on the partners that all of them have in common, by every reader alike."""

import dataclasses
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import assistax_zoo as az
from evaluation.cast.met_partners import MetPartners
from evaluation.figures.comparable import Evaluated, comparable, method_figures
from evaluation.figures.league import read_league
from evaluation.figures.normalised import COLUMN, ZERO, bounds_table
from evaluation.figures.saved_tables import profile_table, save_evaluation
from evaluation.figures.summary import SplitName, read_summary
from evaluation.plots.figures import evaluation_figure
from evaluation.record import manifest, tables
from evaluation.record.record import Record
from tests.evaluation.episode_tables import CONTEXT, episode_table, sealed, team_id, teams

PARTNERS = teams(6)
NAMES = [f"{team_id(team)}/human" for team in PARTNERS]
SIDES = ["test", "train", "test", "test", "train", "test"]
CONTRASTS = f"""schema = 1
alpha = 0.05

[[contrasts]]
task = "scratch"
split = "{CONTEXT.split.id if CONTEXT.split else ""}"
method = "a"
baseline = "b"
seeds = 2
"""


def method(
    folder: Path,
    *met: int,
    seeds: int = 2,
    partners: slice = slice(None),
    change: Callable[[pl.DataFrame], pl.DataFrame] = lambda table: table,
    references: bool = False,
    context: dict[str, Any] | None = None,
    identity: dict[str, Any] | None = None,
    made_with: dict[str, str] | None = None,
) -> Path:
    """Save an evaluation in which robots met some partners, and earn much more with these.

    The folder's name is the method's; `b` earns 10 more than others. `change` is of the table,
    `context` of the summary. A folder without `identity` has no manifest.
    """
    returns = np.random.default_rng(0).normal(500, 80, (1, 6, 3)).repeat(seeds, axis=0)
    returns += 10.0 * (folder.name == "b") + np.arange(seeds)[:, None, None]
    returns[:, list(met)] += 1000.0
    robots = [f"{folder.name}-{seed}" for seed in range(seeds)]
    playing = PARTNERS[partners], SIDES[partners]
    table = change(episode_table(returns[:, partners], robots, *playing))
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    played = None
    if references:
        still = episode_table(returns[:1, partners] / 10, [ZERO], *playing)
        still = still.with_columns(pl.lit(ZERO).alias(COLUMN))
        played = still, bounds_table(still)
    save_evaluation(
        Record(table, folder),
        dataclasses.replace(CONTEXT, **(context or {})),
        references=played,
        met=MetPartners(("registry",), own=frozenset(NAMES[place] for place in met)),
    )
    return folder if identity is None else sealed(folder, made_with, **identity)


def named(folder: Path, *methods: Path) -> Any:
    path = folder / "contrasts.toml"
    path.write_text(CONTRASTS)
    return az.compare_named(path, methods)


def notes_of(reader: str, folder: Path) -> Sequence[str]:
    found = READERS[reader](folder)
    return found.about if reader == "figures" else found.notes


READERS: dict[str, Callable[[Path], Any]] = {
    "compare": lambda root: az.compare(root / "a", root / "b"),
    "contrasts": lambda root: named(root, root / "a", root / "b"),
    "figures": lambda root: method_figures({"a": root / "a", "b": root / "b"}),
    "league": read_league,
}


def test_all_readers_show_the_same_means(tmp_path: Path) -> None:
    """Robots of `a` met the first partner, those of `b` the fourth: both are left out of all."""
    a, b = method(tmp_path / "a", 0, 1), method(tmp_path / "b", 3, seeds=3)
    met_by_none = pl.col("partner").is_in([NAMES[2], NAMES[5]])
    played = [tables.read_episodes(folder / tables.EPISODES_FILE) for folder in (a, b)]
    tested = [table.filter(met_by_none)["return"].to_numpy().mean(dtype=float) for table in played]
    compared = az.compare(a, b)
    assert compared.test is not None and compared.train is not None
    assert compared.test.means == pytest.approx(tested)
    assert compared.test.mean == pytest.approx(tested[0] - tested[1])
    assert (compared.test.seeds, compared.test.partners) == ((2, 3), 2)
    assert (compared.train.seeds, compared.train.partners) == ((2, 3), 1)
    assert "compared on the 3 partners that all have in common" in compared.notes
    figures = method_figures({"a": a, "b": b}).summaries
    for name, mean, seeds in (("a", tested[0], 2), ("b", tested[1], 3)):
        m_test = figures[name].m_test
        assert m_test is not None and m_test.mean == pytest.approx(mean)
        assert figures[name].partners == {"train": 1, "test": 2}
        assert len(figures[name].egos) == seeds
    rows = {row.row: row for row in read_league(tmp_path).rows}
    assert [rows[name].mean.mean for name in "ab"] == pytest.approx(tested)
    assert [(rows[name].robots, rows[name].partners) for name in "ab"] == [(2, 2), (3, 2)]
    [contrast] = named(tmp_path, a, b).contrasts
    assert contrast.difference.means == pytest.approx(tested)
    assert (contrast.seeds, contrast.partners) == ((2, 3), 2)


def test_methods_with_other_partners_share_the_common_ones(tmp_path: Path) -> None:
    a, b = method(tmp_path / "a"), method(tmp_path / "b", partners=slice(2, 5))
    compared = az.compare(a, b)
    assert compared.test is not None and compared.test.partners == 2
    assert compared.test.mean == pytest.approx(-10)
    c = method(tmp_path / "c", partners=slice(2))
    with pytest.raises(ValueError, match=r"b, .*c have no partner in common"):
        az.compare(b, c)
    met = method(tmp_path / "d", 2, 3)
    with pytest.raises(ValueError, match="every common partner was trained with a robot of one"):
        az.compare(met, method(tmp_path / "e", 4, partners=slice(2, 5)))


def test_figures_of_the_same_partners_stay_as_saved(tmp_path: Path) -> None:
    a, b = method(tmp_path / "a", 0, identity={}), method(tmp_path / "b", 0, identity={})
    figures = method_figures({"a": a, "b": b}, profiles=True)
    assert figures.summaries == {"a": read_summary(a), "b": read_summary(b)}
    assert figures.profiles["a"].equals(tables.read_parquet(a / tables.PROFILE_FILE))
    assert figures.about == ()  # hence the same caption too


def test_figures_of_common_partners_are_drawn_again(tmp_path: Path) -> None:
    a = method(tmp_path / "a", references=True, identity={})
    b = method(tmp_path / "b", 0, 2, 3, identity={})
    figures = method_figures({"a": a, "b": b}, profiles=True)
    left = Record.read(a).without([NAMES[place] for place in (0, 2, 3)])
    assert figures.profiles["a"].equals(profile_table(left))
    assert figures.profiles["b"].equals(tables.read_parquet(b / tables.PROFILE_FILE))
    mine = figures.summaries["a"]
    zero = tables.read_parquet(a / tables.REFERENCES_FILE).filter(partner=NAMES[5])
    assert mine.references is not None and mine.references.zero_action is not None
    assert mine.references.zero_action.mean == pytest.approx(zero["return"].mean())
    assert mine.references.zero_action.n == 1 and mine.worst_partner.partner == NAMES[5]
    assert mine.met is not None and set(mine.met.left_out) == {NAMES[p] for p in (0, 2, 3)}


@pytest.mark.parametrize("kind", ["zsc", "disability", "profile"])
def test_a_caption_says_which_partners_are_compared(tmp_path: Path, kind: str) -> None:
    a, b = method(tmp_path / "a", 0, identity={}), method(tmp_path / "b", 3, identity={})
    drawn = evaluation_figure([a, b], kind, tmp_path / "x.png")
    caption = " ".join(" ".join(text.get_text() for text in drawn.texts).split())
    assert "compared on the 4 partners that all have in common" in caption
    assert f"left out of both: {NAMES[0]}, {NAMES[3]}" in caption
    assert caption.count("2 train partners, 2 test partners") == 2


OTHER: dict[str, tuple[dict[str, Any], str]] = {
    "preferences": ({"preferences": ["p9"]}, r'preferences is \["p1"\] in .*a and \["p9"\] in'),
    "no preferences": ({"preferences": None}, r'preferences is \["p1"\] in .*a and none in'),
    "wishes of a side": ({"side_preferences": {"test": ["p1"]}}, "side_preferences is none in"),
    "drawn actions": ({"stochastic": True}, "stochastic is false in .*a and true in .*b"),
    "seed": ({"seed": 1}, "seed is 0 in .*a and 1 in .*b"),
    "evaluator": ({"evaluator_version": 5}, "evaluator_version is none in .*a and 5 in .*b"),
}
ROW = [NAMES[2], "d1", "test", "0" * 64, None]
OTHER_PARTNERS: dict[str, tuple[dict[int, Any], str]] = {
    "parameters": ({3: "1" * 64}, "digest of partner .*s2.* is 000.* in .*a and 111.* in .*b"),
    "setting": ({4: [0.5]}, r"setting of partner .*s2.* is none in .*a and \[0.5\] in .*b"),
    "disability": ({1: "d2"}, "disability of partner .*s2.* is d1 in .*a and d2 in .*b"),
    "side": ({2: "train"}, "side of partner .*s2.* is test in .*a and train in .*b"),
}
OTHER_CONTEXT: dict[str, tuple[dict[str, Any], str]] = {
    "release": ({"release": "v1"}, "release is v0 in .*a and v1 in .*b"),
    "split": ({"split": SplitName("mine", "0" * 64)}, "split is scratch-half-v0 in .* mine in"),
    "split's bytes": (
        {"split": SplitName("scratch-half-v0", "1" * 64)},
        "sha256 of the split is 000.* in .*a and 111.* in .*b",
    ),
    "version": ({"env_version": 2}, "env_version is 1 in .*a and 2 in .*b"),
    "backend": ({"backend": "mjx"}, "backend is native in .*a and mjx in .*b"),
    "engine": ({"engine": {"version": "9"}}, r"engine is \{\} in .*a and .*9.* in .*b"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("what", [*OTHER, *OTHER_PARTNERS, *OTHER_CONTEXT, "episodes", "starts"])
def test_folders_played_otherwise_are_refused(reader: str, what: str, tmp_path: Path) -> None:
    first: dict[str, Any] = {"preferences": ["p1"], "seed": 0, "partners": [ROW]}
    second: dict[str, Any] = {"identity": dict(first)}
    if what in OTHER:
        changed, words = OTHER[what]
        second["identity"] |= changed
    elif what in OTHER_PARTNERS:
        changed, words = OTHER_PARTNERS[what]
        row = [changed.get(place, value) for place, value in enumerate(ROW)]
        second["identity"]["partners"] = [row]
    elif what in OTHER_CONTEXT:
        second["context"], words = OTHER_CONTEXT[what]
    elif what == "episodes":
        second["change"] = lambda table: table.filter(pl.col("episode") < 2)
        words = "episodes_per_pair is 3 in .*a and 2 in .*b"
    else:
        second["change"] = lambda table: table.with_columns(pl.col("key") + 1)
        words = "b and .*a met .* in different episodes"
    method(tmp_path / "a", identity=first)
    method(tmp_path / "b", **second)
    with pytest.raises(ValueError, match=words):
        READERS[reader](tmp_path)


@pytest.mark.parametrize("reader", READERS)
def test_a_folder_without_a_manifest_is_told(reader: str, tmp_path: Path) -> None:
    method(tmp_path / "a", identity={"stochastic": True})
    method(tmp_path / "b")
    words = re.compile(r"no manifest says how (\S*/)?b played: ")
    assert any(map(words.search, notes_of(reader, tmp_path)))


@pytest.mark.parametrize("reader", READERS)
def test_different_series_are_noted(reader: str, tmp_path: Path) -> None:
    """Both play the same episodes, so the difference is the effect of memory."""
    method(tmp_path / "a", identity={"series": 3})
    method(tmp_path / "b", identity={})
    assert any("remembers its partner: 3 in" in note for note in notes_of(reader, tmp_path))


def test_other_software_and_processors_are_notes(tmp_path: Path) -> None:
    a = method(tmp_path / "a", identity={}, made_with={"processor": "x"})
    b = method(tmp_path / "b", identity={"software": {"jax": "0.8"}}, made_with={"processor": "y"})
    notes = az.compare(a, b).notes
    assert f"jax is 0.7.0 in {a}, 0.8 in {b}: returns may differ for that alone" in notes
    assert f"processor is x in {a}, y in {b}: returns may differ for that alone" in notes


def test_told_robots_are_comparable_only_in_leagues(tmp_path: Path) -> None:
    engine = {"version": "3"}
    told = {**engine, "condition": "told"}
    method(tmp_path / "ppo", context={"engine": engine}, identity={"engine": engine})
    method(tmp_path / "told-preference", context={"engine": told}, identity={"engine": told})
    assert [row.row for row in read_league(tmp_path).rows] == ["ppo", "told-preference"]
    for both in (az.compare, lambda *folders: method_figures({f.name: f for f in folders})):
        with pytest.raises(ValueError, match=r"engine is .* and .*told.* in"):
            both(tmp_path / "ppo", tmp_path / "told-preference")


def test_partial_rows_keep_others_partners(tmp_path: Path) -> None:
    method(tmp_path / "ppo", 0)
    method(tmp_path / "gru", partners=slice(4))
    method(tmp_path / "best-response", partners=slice(1, 3))
    rows = {row.row: row.partners for row in read_league(tmp_path).rows}
    assert rows == {"ppo": 2, "gru": 2, "best-response": 1}


def test_a_manifest_of_another_job_is_refused(tmp_path: Path) -> None:
    a, b = method(tmp_path / "a", identity={}), method(tmp_path / "b", identity={})
    content = manifest.read_manifest(b) or {}
    manifest.write_manifest(b, {**content, "job": "0" * 64})
    with pytest.raises(ValueError, match="names another job than the identity it holds"):
        az.compare(a, b)


def test_one_evaluation_needs_no_other(tmp_path: Path) -> None:
    folder = method(tmp_path / "a", 0)
    (folder / tables.EPISODES_FILE).unlink()  # a figure of one folder is of what it saved
    assert method_figures({"a": folder}).summaries == {"a": read_summary(folder)}
    both = [Evaluated.read(method(tmp_path / name), name) for name in ("b", "c")]
    assert comparable(both).records[0].returns.partners["partner"].to_list() == NAMES
