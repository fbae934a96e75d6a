"""What is sent to Weights & Biases is what the metrics hold; the real package keeps it offline."""

import dataclasses
import json
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest
import wandb
from wandb.proto import wandb_internal_pb2

from population.config import make_members

# The log as `train_population` makes it, for a toy environment.
from population.runs.logged_run import _log
from population.runs.tensorboard import scalars
from population.runs.train import train
from population.runs.wandb_run import WandbRuns
from tests.population.test_train import CONFIG, Killed, kill_after
from tests.population.toy_env import ToyEnv, match

Record: Any = vars(wandb_internal_pb2)["Record"]  # made by protobuf, unseen by type checkers
TWO = dataclasses.replace(CONFIG, members=make_members([0], ["d1", "d9"]))


@pytest.fixture(autouse=True)
def alone(tmp_path: Path, monkeypatch) -> Iterator[None]:
    """Keep W&B offline, and away from the user's own settings and key."""
    for name in ("HOME", "WANDB_CONFIG_DIR", "WANDB_CACHE_DIR", "WANDB_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "home"))
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    monkeypatch.delenv("WANDB_API_KEY", raising=False)
    yield
    wandb.teardown()


def kept(folder: Path) -> dict[str, list[Any]]:
    """Return what W&B keeps of each run in a folder, by the run's id."""
    records = {}
    for file in sorted(folder.glob("wandb/offline-run-*/run-*.wandb")):
        run = records.setdefault(file.stem.removeprefix("run-"), [])
        run += map(Record.FromString, logged(file.read_bytes()))
    return records


def logged(data: bytes, block: int = 32768) -> Iterator[bytes]:
    """Yield the records of a log: of LevelDB's format, behind a header of seven bytes."""
    assert data.startswith(b":W&B")
    place, whole = 7, b""
    while place < len(data):
        if block - place % block < 7:  # no header fits behind the last record of a block
            place += block - place % block
            continue
        _, size, part = struct.unpack_from("<IHB", data, place)
        whole += data[place + 7 : place + 7 + size]
        place += 7 + size
        if part in (1, 4):  # a whole record, or the last part of one
            yield whole
            whole = b""


def history(records: list[Any]) -> list[dict[str, float]]:
    rows = [record.history for record in records if record.HasField("history")]
    return [
        {"/".join(item.nested_key) or item.key: json.loads(item.value_json) for item in row.item}
        for row in rows
    ]


@pytest.mark.slow
def test_every_member_has_a_run_with_its_metrics(tmp_path: Path) -> None:
    log = _log(TWO, tmp_path / "run", "wandb:study")
    train(TWO, ToyEnv(match), tmp_path / "run", progress=log)
    log.catch_up()
    log.close()
    table = pl.read_parquet(tmp_path / "run" / "metrics.parquet")
    runs = kept(tmp_path / "run").values()
    assert len(runs) == len(TWO.members)
    for records in runs:
        [started] = [record.run for record in records if record.HasField("run")]
        assert (started.project, started.run_group) == ("study", "run")
        [member] = [i for i, m in enumerate(TWO.members) if started.display_name.endswith(m.label)]
        rows = list(table.filter(member=member).iter_rows(named=True))
        for sent, row in zip(history(records), rows, strict=True):
            assert sent.pop("speed/steps_per_second") > 0
            assert sent.pop("_step") == row["steps"]
            sent = {name: value for name, value in sent.items() if not name.startswith("_")}
            assert sent == pytest.approx(scalars(row))
            assert "episode/reward" in sent and not any("seed" in name for name in sent)


@pytest.mark.slow
def test_resumed_run_continues_its_wandb_run(tmp_path: Path) -> None:
    def stopped(progress) -> None:
        log(progress)
        kill_after(4)(progress)

    log = _log(TWO, tmp_path / "run", "wandb:study")
    with pytest.raises(Killed):
        train(TWO, ToyEnv(match), tmp_path / "run", progress=stopped)
    log.close()
    before = set(kept(tmp_path / "run"))
    log = _log(TWO, tmp_path / "run", "wandb:study")
    train(TWO, ToyEnv(match), tmp_path / "run", progress=log)
    log.close()
    assert len(before) == len(TWO.members)
    assert set(kept(tmp_path / "run")) == before


def test_other_folder_gets_no_wandb_run(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    log = _log(TWO, tmp_path / "run", "wandb:study")
    with pytest.raises(ValueError, match="is not the folder of a run"):
        train(TWO, ToyEnv(match), tmp_path / "run", progress=log)
    log.close()
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_missing_key_says_how_to_log_in(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.delenv("WANDB_MODE")
    log = _log(TWO, tmp_path / "run", "wandb:study")
    with pytest.raises(ValueError, match=r"`wandb login`.*WANDB_MODE=offline"):
        train(TWO, ToyEnv(match), tmp_path / "run", progress=log)


def test_without_the_package_it_says_what_to_install(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(ValueError, match=r"assistax-zoo\[wandb\]"):
        WandbRuns(CONFIG, tmp_path, "study")
