"""Event files of a run, read back by TensorBoard's own reader."""

import contextlib
import math
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from population.runs.tensorboard import EventFiles, tag
from population.runs.train import Progress, train
from tests.population.test_train import CONFIG, Killed, kill_after
from tests.population.toy_env import ToyEnv, match

MEMBERS = ("toy-ippo-d1-s0", "toy-ippo-d1-s3", "toy-ippo-d9-s0", "toy-ippo-d9-s3")


def scalars(folder: Path, *, all_files: bool = False) -> dict[str, list[tuple[int, float]]]:
    """Return (step, value) by tag as TensorBoard shows a member, or all that its files hold."""
    reader = EventAccumulator(
        str(folder), size_guidance={"scalars": 0}, purge_orphaned_data=not all_files
    ).Reload()
    return {
        name: [(event.step, event.value) for event in reader.Scalars(name)]
        for name in reader.Tags()["scalars"]
    }


def run(folder, events, killed_at=None):
    """Train with event files, until the run is killed if it is."""
    with contextlib.closing(EventFiles(CONFIG, folder, events)) as files:

        def progress(report):
            files(report)
            if killed_at is not None:
                kill_after(killed_at)(report)

        train(CONFIG, ToyEnv(match), folder, progress=progress)
        files.catch_up()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("events")
    run(folder / "run", folder / "tb")
    return folder


def check(events, metrics, speeds):
    """Check that the files hold each step of the metrics once, in order, with its values."""
    table = pl.read_parquet(metrics)
    assert sorted(path.name for path in events.iterdir()) == sorted(MEMBERS)
    for member, name in enumerate(MEMBERS):
        series, rows = scalars(events / name), table.filter(pl.col("member") == member)
        assert [step for step, _ in series["episode/reward"]] == rows["steps"].to_list()
        assert len(series.pop("speed/steps_per_second")) == speeds
        logged = [column for column in rows.columns if tag(column) in series]
        assert set(map(tag, logged)) == set(series)
        expected = "return term_robot term_human policy_loss_robot value_loss_human"
        assert set(expected.split()) <= set(logged)
        for column in logged:
            expected = rows.select("steps", column).drop_nulls().to_numpy()
            np.testing.assert_allclose(series[tag(column)], expected, rtol=1e-6, err_msg=column)


def test_event_files_hold_what_the_metrics_hold(whole):
    check(whole / "tb", whole / "run" / "metrics.parquet", speeds=6)


@pytest.mark.slow
def test_resumed_run_shows_each_step_once(tmp_path, monkeypatch):
    """It is killed before, just after and an update after its first checkpoint; files are torn."""
    now = time.time()
    for second, update in enumerate((1, 2, 3)):
        monkeypatch.setattr(time, "time", lambda second=second: now + second)  # names the files
        with pytest.raises(Killed):
            run(tmp_path / "run", tmp_path / "tb", killed_at=update)
        for path in (tmp_path / "tb").rglob("events.*"):
            path.write_bytes(path.read_bytes()[:-5])
    monkeypatch.setattr(time, "time", lambda: now + 3)
    run(tmp_path / "run", tmp_path / "tb")
    # Updates 1 and 2 are taken from the metrics, which know no speed.
    check(tmp_path / "tb", tmp_path / "run" / "metrics.parquet", speeds=4)
    member = tmp_path / "tb" / MEMBERS[0]
    assert len(list(member.iterdir())) == 4
    written = [step for step, _ in scalars(member, all_files=True)["episode/reward"]]
    assert len(written) > len(set(written)) == 6


def test_a_run_without_files_gets_its_past_written(whole, tmp_path):
    run(whole / "run", tmp_path / "late")  # finished: nothing is trained
    late, first = (scalars(folder / MEMBERS[2]) for folder in (tmp_path / "late", whole / "tb"))
    assert late["episode/return"] == first["episode/return"]


def test_files_of_another_run_are_refused(whole, tmp_path):
    message = "holds event files of another run of toy-ippo-d1-s0; choose another folder"
    with pytest.raises(ValueError, match=message):
        EventFiles(CONFIG, tmp_path / "new", whole / "tb")
    EventFiles(CONFIG, whole / "run", whole / "tb").close()  # the run itself


def test_nonfinite_loss_is_written(tmp_path):
    files = EventFiles(CONFIG, tmp_path / "run", tmp_path / "tb")
    row = {"update": 1, "steps": 80, "seconds": 1.0, "member": 0, "return": None}
    row["policy_loss_robot"] = math.nan
    files(Progress(1, 6, 320, 1920, 100.0, 16.0, pl.DataFrame([row])))
    files.close()
    logged = scalars(tmp_path / "tb" / MEMBERS[0])
    assert math.isnan(logged["learning/policy_loss_robot"][0][1]) and "episode/return" not in logged
    assert logged["speed/steps_per_second"] == [(80, 25.0)]


def test_without_the_library_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX.event_file_writer", None)
    message = r"install it with: pip install 'assistax-zoo\[tensorboard\]'"
    with pytest.raises(ValueError, match=message):
        EventFiles(CONFIG, tmp_path / "run", tmp_path / "tb")
