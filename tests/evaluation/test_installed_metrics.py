"""Metrics and columns that installed packages add to evaluations and cross-plays."""

import dataclasses
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from assistax_base.extensions import METRICS, ExtensionError
from evaluation.figures.metrics.installed import find_metrics
from evaluation.figures.saved_tables import save_crossplay, save_evaluation
from evaluation.figures.summary import read_summary, summarise_evaluation
from evaluation.play.how import PlaySettings
from evaluation.play.jobs import Job
from evaluation.record import tables
from evaluation.record.alike import COLUMNS, conditions
from evaluation.replay.metrics import received_metrics
from tests.evaluation.episode_tables import CONTEXT, recorded
from tests.evaluation.matrix_game import humans, robots
from tests.evaluation.test_series import job_of, played

MODULE = """
import numpy as np
from evaluation.figures.metrics.installed import Metric
from population.play.tally import Column

class Pay(Column):
    def add(self, value, before, state, time):
        return value + (time + 1) * state.reward

PAY = Metric("weighted pay", lambda returns: returns.column("metric_pay"), Pay())
SPEED = Metric("return of a step", lambda returns: returns.values / returns.column("steps"))
PAIRS = Metric("scores", lambda returns: returns.scores)
FLAT = Metric("wrong shape", lambda returns: returns.scores.mean())
NAN = Metric("not finite", lambda returns: returns.values * np.nan)
OTHER = 3
"""


@pytest.fixture
def install(install_package: Callable[..., None], tmp_path: Path) -> Iterator[Callable[..., None]]:
    """Return a function that installs a package with one metric of `MODULE`."""
    (tmp_path / "outside_metrics.py").write_text(MODULE)
    yield lambda name, **options: install_package(
        METRICS, name, f"outside_metrics:{name.upper()}", **options
    )
    sys.modules.pop("outside_metrics", None)


def with_metrics(job: Job, *names: str) -> Job:
    return dataclasses.replace(job, metrics=find_metrics(names))


def test_a_column_is_added_up_and_changes_nothing_else(install: Callable[..., None]) -> None:
    install("pay")
    job = job_of(robots(0.5, -0.5), humans(0.5, -0.5, disabilities=("d1", "d2")))
    plain, table = played(job), played(with_metrics(job, "pay"))
    assert table.columns == [*plain.columns, "metric_pay"]
    assert table.drop("metric_pay").equals(plain)
    # Of four equal rewards r the weighted sum is 10 r.
    steps = (plain["term_payoff"] + plain["term_luck"]) / 4
    np.testing.assert_allclose(table["metric_pay"], 10 * steps, rtol=1e-5)


def test_only_jobs_with_columns_have_another_digest(install: Callable[..., None]) -> None:
    install("pay")
    install("speed", package="second")
    job = job_of(robots(0.5))
    assert COLUMNS not in job.identity()
    assert with_metrics(job, "speed").digest() == job.digest()
    identity = with_metrics(job, "pay").identity()
    assert identity[COLUMNS] == {"pay": {"package": "outside", "version": "0.3"}}
    assert conditions(identity) == conditions(job.identity())


def test_figures_stand_under_more(install: Callable[..., None], tmp_path: Path) -> None:
    for name, package in (("pay", "outside"), ("speed", "second"), ("pairs", "third")):
        install(name, package=package)
    job = with_metrics(job_of(robots(0.5, -0.5)), "pay", "speed", "pairs")
    record = recorded(played(job), tmp_path)
    summary = summarise_evaluation(record, CONTEXT, job.metrics)
    assert list(summary.more) == ["pay", "speed", "pairs"]
    assert summary.m_test is not None
    assert summary.more["speed"].mean == pytest.approx(summary.m_test.mean / 4)
    assert summary.more["pairs"].mean == pytest.approx(summary.m_test.mean)
    pay = summary.more["pay"]
    assert (pay.title, pay.package, pay.version) == ("weighted pay", "outside", "0.3")
    assert pay.mean == pytest.approx(record.table["metric_pay"].mean())
    assert pay.generalises_to == "seeds, partners and starts"


@pytest.mark.parametrize("save", [save_evaluation, save_crossplay])
def test_a_folder_is_read_without_the_package(
    install: Callable[..., None], tmp_path: Path, save: Callable
) -> None:
    install("pay")
    job = with_metrics(job_of(robots(0.5, -0.5)), "pay")
    folder = tmp_path / "folder"
    folder.mkdir()
    tables.write_episodes(played(job), folder / tables.EPISODES_FILE)
    record = recorded(tables.read_episodes(folder / tables.EPISODES_FILE), folder)
    assert save(record, CONTEXT).more == {}
    assert "more" not in tables.read_json(folder / tables.SUMMARY_FILE)
    save(record, CONTEXT, metrics=job.metrics)
    (tmp_path / "outside-0.3.dist-info" / "entry_points.txt").unlink()
    summary = read_summary(folder)
    assert summary.more["pay"].title == "weighted pay"
    received = received_metrics(job.identity(), summary)
    assert received.installed == {} and received.notes == [
        "metric 'pay' of 'outside 0.3', which is not installed: cannot be told"
    ]
    assert "metric_pay" not in received.without_absent(record.table).columns
    assert "more" not in received.without_figures(tables.read_json(folder / tables.SUMMARY_FILE))


def test_another_version_cannot_tell_a_received_metric(install: Callable[..., None]) -> None:
    install("pay")
    job = with_metrics(job_of(robots(0.5)), "pay")
    record, identity = recorded(played(job)), job.identity()
    received = received_metrics(identity, summarise_evaluation(record, CONTEXT, job.metrics))
    assert list(received.installed) == ["pay"] and received.absent == {}
    assert received.noise_notes(record.table) == ["metric_pay on another processor: cannot be told"]
    identity[COLUMNS]["pay"]["version"] = "0.4"
    received = received_metrics(identity, summarise_evaluation(record, CONTEXT))
    assert received.absent == {"pay": "outside 0.4"} and received.noise_notes(record.table) == []
    with pytest.raises(ValueError, match="metric 'pay' is of another package in the manifest"):
        received_metrics(identity, summarise_evaluation(record, CONTEXT, job.metrics))


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("flat", r"expected finite values of shape \(1, 3, 6\) or \(1, 3\), found .* \(\), finite"),
        ("nan", r"values of shape \(1, 3, 6\), not finite"),
        ("other", "expected a `Metric` of .*, found 3"),
    ],
)
def test_a_wrong_metric_names_its_package(
    install: Callable[..., None], name: str, problem: str
) -> None:
    install(name)
    record = recorded(played(job_of(robots(0.5))))
    with pytest.raises(ExtensionError, match=f"'{name}' of the package outside 0.3 .*{problem}"):
        summarise_evaluation(record, CONTEXT, find_metrics([name]))


def test_unknown_metrics_are_refused_with_the_known_ones(install: Callable[..., None]) -> None:
    with pytest.raises(ValueError, match="metric is 'calm'; no installed package has one"):
        PlaySettings("scratch", metrics="calm")
    install("pay")
    with pytest.raises(ValueError, match="metric is 'calm'; allowed are pay"):
        PlaySettings("scratch", metrics="pay,calm")
    assert PlaySettings("scratch", metrics="pay").metric_names == ("pay",)
    assert "outside_metrics" not in sys.modules


def test_a_column_of_text_is_no_column_of_numbers() -> None:
    returns = recorded(played(job_of(robots(0.5)))).returns
    np.testing.assert_array_equal(returns.column("return"), returns.values)
    few = returns.select_partners(np.array([True, False, True]))
    np.testing.assert_array_equal(few.column("key"), few.pair_keys)
    for name in ("partner", "nonsense"):
        with pytest.raises(ValueError, match=f"column is '{name}'; columns of numbers are ego_"):
            returns.column(name)
