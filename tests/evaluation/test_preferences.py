"""What the humans of a gentle task like, from the job to the figures."""

import dataclasses
from collections import Counter, namedtuple
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest
from pydantic import TypeAdapter

from assistax_envs.preferences import PREFERENCES
from evaluation.ego_training import prepare
from evaluation.figures.comparable import summarise_comparison
from evaluation.figures.saved_tables import save_evaluation
from evaluation.figures.summary import (
    EvaluationSummary,
    SplitName,
    read_summary,
    summarise_evaluation,
)
from evaluation.play.evaluator import run_job
from evaluation.play.how import PlaySettings
from evaluation.play.jobs import Job
from evaluation.plots.charts import trait_points
from evaluation.record import tables
from evaluation.record.columns import (
    GENTLE,
    TOUCH,
    TOUCHES,
    validate_episodes,
)
from evaluation.record.record import Record
from evaluation.replay.replay import replay_folder
from evaluation.report.page import write_report
from tests import untrained
from tests.evaluation.episode_tables import CONTEXT, recorded
from tests.evaluation.matrix_game import HUMAN, ROBOT, MatrixGame, Measures, humans, robots
from tests.studies import cross_play, evaluate_policies
from zoo.registry import Registry, load_registry
from zoo.splitting.create import create_split

NAMES = tuple(PREFERENCES)


class Fond(MatrixGame):
    """Each step pays the number of the human's preference; partners of pk press with k N in all.

    Preference p9 is violated, and a pair in row 1 reaches the goal.
    """

    def reset(self, keys: Any, params: Any) -> Any:
        state = super().reset(keys, params)
        return state._replace(measures=self._felt(state))

    def step(self, state: Any, actions: Any) -> Any:
        after = super().step(state, actions)
        return after._replace(
            measures=self._felt(after), reward=state.params.preference_code.astype(jnp.float32)
        )

    @staticmethod
    def _felt(state: Any) -> Any:
        contact = state.params.preference_code.astype(jnp.float32)
        return state.measures._replace(contact=contact, violated=contact == 9.0)


def job_of(**changes: Any) -> Job:
    partners = humans(-0.5, 0.5, 0.5, disabilities=("d1", "d2", "d1"))
    options = {"episodes": 9, "preferences": NAMES, **changes}
    sides = dict.fromkeys(partners.ids, "test")
    return Job("matrix", 1, "native", robots(-0.5, 0.5), partners, sides=sides, **options)


def played(folder: Path, **changes: Any) -> pl.DataFrame:
    return run_job(Fond(), job_of(**changes), folder).table


def test_each_partner_takes_turns_and_begins_elsewhere() -> None:
    partners = [f"scratch/ippo-d1-s{seed}-v1/human" for seed in range(90)]
    wishes = job_of().preferences_of(partners, range(9))
    assert wishes.shape == (90, 9)
    assert all(sorted(row) == sorted(NAMES) for row in wishes)
    assert {len(set(wishes[:, k])) for k in range(9)} == {9}  # every start under all of them
    eight = Counter(job_of().preferences_of(partners, range(8)).ravel())
    assert max(eight.values()) < 1.25 * min(eight.values())
    again = job_of().preferences_of(partners[5:6], [3, 12])
    np.testing.assert_array_equal(again, wishes[5:6, [3, 3]])


def test_table_has_preference_of_each_episode(tmp_path: Path) -> None:
    job, table = job_of(), played(tmp_path / "job")
    validate_episodes(table)
    for row in table.iter_rows(named=True):
        [[wished]] = job.preferences_of([row["partner"]], [row["episode"]])
        assert row["preference"] == wished
        k = NAMES.index(wished) + 1
        assert row["return"] == pytest.approx(k * row["steps"])
        assert row["contact_peak"] == k and row["violated"] == (k == 9)
    few = played(tmp_path / "few", episodes=2)
    whole = table.filter(pl.col("episode") < 2)
    assert few.equals(whole)  # more episodes extend fewer


def test_preferences_are_part_of_job(tmp_path: Path) -> None:
    """Folders and episodes of the paper's tasks are found by the identity that they had."""
    without = job_of(preferences=())
    assert "preferences" not in without.identity()
    assert job_of().identity() == {**without.identity(), "preferences": list(NAMES)}
    assert len({without.digest(), job_of().digest(), job_of(preferences=("p1",)).digest()}) == 3
    table = run_job(MatrixGame(), without, tmp_path / "old").table
    assert not set(GENTLE) & set(table.columns)
    alone = played(tmp_path / "new", preferences=("p5",))
    assert alone["preference"].unique().to_list() == ["p5"]


def test_figures_by_preference_are_means_over_partners(tmp_path: Path) -> None:
    table = played(tmp_path)
    summary = summarise_evaluation(recorded(table), CONTEXT)
    steps = int(table["steps"][0])
    assert list(summary.by_preference) == sorted(NAMES)
    for k, name in enumerate(NAMES, 1):
        figure = summary.by_preference[name]
        assert (figure.mean, figure.n) == (pytest.approx(k * steps), 2 * 3)
    assert summary.preference_fairness is not None
    assert (summary.preference_fairness.worst, summary.preference_fairness.best) == ("p1", "p9")
    assert summary.violations is not None and summary.violations.mean == pytest.approx(1 / 9)
    # Preferences without a partner are left out.
    few = summarise_evaluation(recorded(table.filter(pl.col("episode") < 2)), CONTEXT)
    counts = Counter(job_of().preferences_of(job_of().partners.ids, range(2)).ravel())
    assert {name: figure.n for name, figure in few.by_preference.items()} == {
        str(name): 2 * count for name, count in counts.items()
    }
    assert summary.caring_success is None and summary.adaptation == {}  # not measured here


def test_gentle_folder_has_tables_and_report(tmp_path: Path) -> None:
    table = played(tmp_path / "job")
    summary = save_evaluation(Record(table, tmp_path), CONTEXT)
    assert read_summary(tmp_path) == summary
    partners = tables.read_parquet(tmp_path / tables.PARTNERS_FILE)
    assert partners["violated"].to_list() == pytest.approx([1 / 9] * 3)
    shown = tables.to_json(summary)
    [axes] = trait_points({"mine": shown}, "preference").axes
    assert [label.get_text() for label in axes.get_xticklabels()] == sorted(NAMES)
    write_report(tmp_path, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "test partners who prefer p3" in text
    assert "how people fared" in text and "contact peak" in text
    paper = {**shown, "by_preference": {}}
    with pytest.raises(ValueError, match="no partner of these folders has a preference"):
        trait_points({"mine": paper}, "preference")


class Pressing(Fond):
    """As Fond, and how people are touched is measured: half of the contact counts once more."""

    @staticmethod
    def _felt(state: Any) -> Any:
        felt = state.params.preference_code.astype(jnp.float32)
        return Pressed(*state.measures[:3], felt, felt == 9.0, 1.5 * felt, felt > 6.0, felt, felt)


Pressed = namedtuple("Pressed", (*Measures._fields, "together", "at_end", "speed", "face"))


@pytest.mark.slow
def test_touch_columns_reach_tables_and_pages(tmp_path: Path) -> None:
    table = run_job(Pressing(), job_of(), tmp_path / "job").table
    one = table.filter(pl.col("preference") == "p8")
    assert one["together_peak"].to_list() == [12.0] * one.height
    assert one["face_least"].to_list() == [8.0] * one.height
    assert set(one["end_share"]) == {1.0}
    assert set(table.filter(pl.col("preference") == "p1")["end_share"]) == {0.0}
    summary = save_evaluation(Record(table, tmp_path), CONTEXT)
    assert set(summary.touch) == set(TOUCH) == set(TOUCHES)
    assert summary.touch["together_peak"].mean == pytest.approx(1.5 * 5.0)
    assert summary.touch["end_share"].mean == pytest.approx(3 / 9)
    assert read_summary(tmp_path) == summary
    fewer = Record(table, tmp_path).without([table["partner"][0]]).returns
    assert fewer.touch["face_least"].shape == fewer.values.shape
    write_report(tmp_path, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert TOUCHES["sustained_force"] in text and "sum at once" in text


def test_older_summary_without_touches_is_read() -> None:
    """A field without a default would make every kept summary of a gentle task unreadable."""
    path = Path(__file__).parent / "golden/summary_before_touch.json"
    content = tables.read_json(path)
    assert "touch" not in content
    summary = TypeAdapter(EvaluationSummary).validate_python(content)
    assert summary.touch == {} and summary.violations
    assert summary.violations.mean == pytest.approx(1 / 9)


SIDES = {"train": ("p2", "p3"), "test": ("p1", "p5", "p9")}


def test_partners_play_under_the_preferences_of_their_side(tmp_path: Path) -> None:
    job = job_of()
    tested = job_of(preferences=SIDES["test"])
    assert job.with_side_preferences(SIDES).identity() == tested.identity()
    partners = job.partners.ids
    sides = dict(zip(partners, ("train", "test", "test"), strict=True))
    mixed = dataclasses.replace(job, sides=sides)
    both = mixed.with_side_preferences(SIDES)
    assert both.identity() == {
        **mixed.identity(),
        "preferences": ["p1", "p2", "p3", "p5", "p9"],
        "side_preferences": {side: list(names) for side, names in SIDES.items()},
    }
    table = run_job(Fond(), both, tmp_path).table
    for side, names in SIDES.items():
        assert set(table.filter(side=side)["preference"]) == set(names)
    alone = dataclasses.replace(mixed, preferences=SIDES["train"])
    # A partner's preferences do not depend on other partners.
    np.testing.assert_array_equal(
        both.preferences_of(partners[:1], range(9)), alone.preferences_of(partners[:1], range(9))
    )
    assert set(both.preferences_of(["passive"], range(9))[0]) == {"p1", "p2", "p3", "p5", "p9"}


def test_preferences_of_other_side_are_noted(tmp_path: Path) -> None:
    split = SplitName("gentle/half-p1-p5-p9", "0" * 64, SIDES)
    context = dataclasses.replace(CONTEXT, split=split)
    warning = "test partners played under p3; the split's test preferences are p1, p5, p9"
    for names, expected in ((("p1", "p5"), []), (("p1", "p3"), [warning])):
        record = recorded(played(tmp_path / names[1], preferences=names))
        notes = summarise_evaluation(record, context).notes
        assert [note for note in notes if "split's" in note] == expected


def test_comparison_refuses_other_preferences(tmp_path: Path) -> None:
    first, other = (played(tmp_path / name, preferences=(name,)) for name in ("p1", "p2"))
    assert summarise_comparison(recorded(first), recorded(first)).test is not None
    with pytest.raises(ValueError, match="has different preferences with the second"):
        summarise_comparison(recorded(first), recorded(other))


@pytest.fixture(scope="module")
def gentle(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    """A registry of untrained teams of gentle lift, whose default split holds preferences out."""
    # Scaled, so that no two policies act alike.
    teams = [
        dataclasses.replace(team, params=jax.tree.map(lambda leaf: 100 * leaf, team.params))
        for team in untrained.teams_of(2, ROBOT, HUMAN, "gentle_lift")
    ]
    path = untrained.published(teams, tmp_path_factory.mktemp("zoo"))
    rule: dict[str, Any] = {"rule": "leave-one-disability-out", "held_out": "d9", "default": True}
    create_split(path, task="gentle_lift", test_preferences=SIDES["test"], **rule)
    return load_registry(path)


@pytest.mark.slow
def test_evaluation_uses_preferences_of_split(
    gentle: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("assistax_envs.make", lambda task, backend, version=None: Fond())
    split = gentle.split("gentle_lift")

    def evaluate(name: str, split: str, **changes: Any) -> tuple[Any, dict[str, set[str]]]:
        settings = PlaySettings("gentle_lift", 9, **changes)
        robots, folder = ["gentle_lift/ippo-d1-s0-v0/robot"], tmp_path / name
        summary = evaluate_policies(gentle, robots, settings, folder, split=split)
        table = tables.read_episodes(folder / tables.EPISODES_FILE)
        return summary, {side: set(rows["preference"]) for (side,), rows in table.group_by("side")}

    both, liked = evaluate("both", "both")
    assert liked == {side: set(names) for side, names in split.preferences.items()}
    assert both.gap is not None and both.split.preferences == split.preferences
    assert sorted(both.by_preference) == ["p1", "p5", "p9"]
    replayed = replay_folder(tmp_path / "both", gentle, sample=9)
    assert replayed.ok and replayed.exact
    chosen, liked = evaluate("asked", "test", preferences="p2")
    assert liked == {"test": {"p2"}} and any("played under p2" in note for note in chosen.notes)
    series, liked = evaluate("series", "test", series=3)
    assert list(series.by_place) == ["1", "2", "3"] and liked == {"test": {"p1", "p5", "p9"}}
    assert replay_folder(tmp_path / "series", gentle, sample=9).exact
    population = cross_play(gentle, "*", "*", PlaySettings("gentle_lift", 9), tmp_path / "xp")
    pairs = tables.read_episodes(tmp_path / "xp" / tables.EPISODES_FILE)
    assert population.episodes == 16 * 9 and set(pairs["preference"]) == set(NAMES)


def test_training_uses_preferences_of_training_side(gentle: Registry) -> None:
    prepared = prepare(gentle, "gentle_lift", steps=1)
    assert prepared.config.preferences == ("p2", "p3", "p4", "p6", "p7", "p8")
    assert "under p2, p3, p4, p6, p7, p8, " in prepared.summary
    assert prepare(gentle, "gentle_lift", preferences=["p1"]).config.preferences == ("p1",)
    half = create_split(
        gentle.path, task="gentle_lift", rule="leave-one-disability-out", held_out="d1"
    )
    named = prepare(load_registry(gentle.path), "gentle_lift", split=half.id)
    assert named.config.preferences == ()


def test_settings_know_preferences_of_their_task() -> None:
    assert PlaySettings("scratch", 8).turns == ()
    assert PlaySettings("gentle_bath", 8).turns == NAMES
    assert PlaySettings("gentle_bath", 8, preferences="p1,p5").turns == ("p1", "p5")


@pytest.mark.parametrize(
    ("task", "names", "message"),
    [
        ("scratch", "p1", "humans of scratch have no preferences; leave them out, or choose"),
        ("gentle_lift", "p1,p10", "preferences are p1, p10; give each .* once, of p1, p2"),
        ("gentle_lift", "p1,p1", "preferences are p1, p1; give each .* once"),
        ("gentle_lift", "", "preferences are none; give each"),
    ],
)
def test_other_preferences_are_refused(task: str, names: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PlaySettings(task, 8, preferences=names)
