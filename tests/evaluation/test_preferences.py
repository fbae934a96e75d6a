"""What the humans of a gentle task like, from the job to the figures."""

from collections import Counter
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

from assistax_envs.preferences import PREFERENCES
from evaluation import tables
from evaluation.derived import save_evaluation
from evaluation.evaluator import run_job
from evaluation.jobs import Job
from evaluation.plots.charts import trait_points
from evaluation.report.page import write_report
from evaluation.studies import Settings
from evaluation.summary import read_summary, summarise_evaluation
from tests.evaluation.episode_tables import CONTEXT
from tests.evaluation.matrix_game import MatrixGame, humans, robots

NAMES = tuple(PREFERENCES)


class Fond(MatrixGame):
    """Each step pays the number of the human's preference; partners of pk press with k N in all.

    Who likes p9 is hurt, and whoever plays row 1 with the other player reaches the goal.
    """

    def reset(self, keys: Any, params: Any) -> Any:
        state = super().reset(keys, params)
        return state._replace(measures=self._felt(state))

    def step(self, state: Any, actions: Any) -> Any:
        after = super().step(state, actions)
        return after._replace(
            measures=self._felt(after), reward=state.params.preference.astype(jnp.float32)
        )

    @staticmethod
    def _felt(state: Any) -> Any:
        contact = state.params.preference.astype(jnp.float32)
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
    wishes = job_of().wishes(partners, range(9))
    assert wishes.shape == (90, 9)
    assert all(sorted(row) == sorted(NAMES) for row in wishes)
    assert {len(set(wishes[:, k])) for k in range(9)} == {9}  # every start under all of them
    eight = Counter(job_of().wishes(partners, range(8)).ravel())
    assert max(eight.values()) < 1.25 * min(eight.values())
    np.testing.assert_array_equal(job_of().wishes(partners[5:6], [3, 12]), wishes[5:6, [3, 3]])


def test_the_table_says_under_which_preference_an_episode_was_played(tmp_path: Path) -> None:
    job, table = job_of(), played(tmp_path / "job")
    tables.validate_episodes(table)
    for row in table.iter_rows(named=True):
        [[wished]] = job.wishes([row["partner"]], [row["episode"]])
        assert row["preference"] == wished
        k = NAMES.index(wished) + 1
        assert row["return"] == pytest.approx(k * row["steps"])
        assert row["contact_peak"] == k and row["violated"] == (k == 9)
    few = played(tmp_path / "few", episodes=2)
    whole = table.filter(pl.col("episode") < 2)
    assert few.equals(whole)  # more episodes extend fewer


def test_a_subset_is_another_job_and_none_is_the_job_that_it_was(tmp_path: Path) -> None:
    """Folders and episodes of the paper's tasks are found by the identity that they had."""
    without = job_of(preferences=())
    assert "preferences" not in without.identity()
    assert job_of().identity() == {**without.identity(), "preferences": list(NAMES)}
    assert len({without.digest(), job_of().digest(), job_of(preferences=("p1",)).digest()}) == 3
    table = run_job(MatrixGame(), without, tmp_path / "old").table
    assert not set(tables.GENTLE) & set(table.columns)
    alone = played(tmp_path / "new", preferences=("p5",))
    assert alone["preference"].unique().to_list() == ["p5"]


def test_figures_by_preference_are_means_over_partners(tmp_path: Path) -> None:
    table = played(tmp_path)
    summary = summarise_evaluation(table, CONTEXT)
    steps = int(table["steps"][0])
    assert list(summary.by_preference) == sorted(NAMES)
    for k, name in enumerate(NAMES, 1):
        figure = summary.by_preference[name]
        assert (figure.mean, figure.n) == (pytest.approx(k * steps), 2 * 3)
    assert summary.preference_fairness is not None
    assert (summary.preference_fairness.worst, summary.preference_fairness.best) == ("p1", "p9")
    assert summary.violations is not None and summary.violations.mean == pytest.approx(1 / 9)
    safe = tables.with_safety(table)
    assert summary.safe_success is not None
    assert summary.safe_success.mean == pytest.approx(safe["safe_success"].mean())
    hurt = safe.filter(pl.col("violated"))
    assert hurt["success"].any() and not hurt["safe_success"].any()


def test_partners_that_did_not_play_under_one_are_left_out_of_it(tmp_path: Path) -> None:
    summary = summarise_evaluation(played(tmp_path, episodes=2), CONTEXT)
    counts = Counter(job_of().wishes(job_of().partners.ids, range(2)).ravel())
    assert {name: figure.n for name, figure in summary.by_preference.items()} == {
        str(name): 2 * count for name, count in counts.items()
    }


def test_a_folder_of_a_gentle_task_is_read_drawn_and_reported(tmp_path: Path) -> None:
    table = played(tmp_path / "job")
    summary = save_evaluation(tmp_path, table, CONTEXT)
    assert read_summary(tmp_path) == summary
    partners = tables.read_parquet(tmp_path / tables.PARTNERS_FILE)
    assert partners["violated"].to_list() == pytest.approx([1 / 9] * 3)
    shown = tables.to_json(summary)
    [axes] = trait_points({"mine": shown}, "preference").axes
    assert [label.get_text() for label in axes.get_xticklabels()] == sorted(NAMES)
    write_report(tmp_path, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "test partners of p3" in text and "safe success" in text and "contact peak" in text
    paper = {**shown, "by_preference": {}}
    with pytest.raises(ValueError, match="no partner of these folders has a preference"):
        trait_points({"mine": paper}, "preference")


def test_settings_know_which_tasks_have_preferences() -> None:
    assert Settings("scratch", 8).wishes == ()
    assert Settings("gentle_bath", 8).wishes == NAMES
    assert Settings("gentle_bath", 8, preferences="p1,p5").wishes == ("p1", "p5")
    assert Settings("gentle_bath", 8, preferences=["p9"]).wishes == ("p9",)


@pytest.mark.parametrize(
    ("task", "names", "told"),
    [
        (
            "scratch",
            "p1",
            "humans of scratch have no preferences; leave them out, or choose gentle",
        ),
        ("gentle_lift", "p1,p10", "preferences are p1, p10; give each .* once, of p1, p2"),
        ("gentle_lift", "p1,p1", "preferences are p1, p1; give each .* once"),
        ("gentle_lift", [], "preferences are none; give each"),
    ],
)
def test_other_preferences_are_refused(task: str, names: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Settings(task, 8, preferences=names)
