"""Parts of a job: those of another job are refused, whatever they are called."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_base.digest import sha256
from assistax_base.files import METADATA_KEY
from evaluation.play import parts
from evaluation.play.evaluator import run_job
from evaluation.play.jobs import Job
from evaluation.play.parts import PARTS_FOLDER
from evaluation.play.shares import run_share
from evaluation.record import tables
from evaluation.record.manifest import describe_machine, read_manifest
from tests.evaluation.matrix_game import HUMAN, MatrixGame, random_roster
from tests.evaluation.test_evaluator import make_job, mixed_job


def share(job: Job, folder: Path, number: int = 1) -> list[Path]:
    """Play one of two shares, and return its parts."""
    run_share(MatrixGame(), job, folder, (number, 2), max_envs=7)
    return sorted((folder / PARTS_FOLDER).glob("part-*"))


def gather(source: Path, target: Path) -> None:
    shutil.copytree(source / PARTS_FOLDER, target / PARTS_FOLDER, dirs_exist_ok=True)


def other_parameters() -> Job:
    """The same ids with other parameters, as another registry may have them."""
    return dataclasses.replace(mixed_job(), partners=random_roster(HUMAN, 5, 4))


@pytest.mark.parametrize(
    "other", [mixed_job(seed=1), other_parameters(), mixed_job(stochastic=True)]
)
def test_parts_of_another_job_are_refused(tmp_path: Path, other: Job) -> None:
    mine = share(mixed_job(), tmp_path / "mine")
    theirs = share(other, tmp_path / "theirs", 2)
    gather(tmp_path / "theirs", tmp_path / "mine")
    for merge in (run_job, lambda *args: run_share(*args, (2, 2), max_envs=7)):
        with pytest.raises(
            ValueError, match=rf"{len(theirs)} parts of the job {other.digest()[:12]}"
        ):
            merge(MatrixGame(), mixed_job(), tmp_path / "mine")
    left = sorted((tmp_path / "mine" / PARTS_FOLDER).glob("part-*"))
    assert {path.name for path in (*mine, *theirs)} == {path.name for path in left}


def test_parts_of_another_cut_and_job_are_refused(tmp_path: Path) -> None:
    """No chunk of this job has their names, so that they would be deleted at the end."""
    share(mixed_job(), tmp_path / "mine")
    run_share(MatrixGame(), make_job(), tmp_path / "theirs", (1, 1), max_envs=4)
    gather(tmp_path / "theirs", tmp_path / "mine")
    with pytest.raises(ValueError, match="other policies, settings or versions played them"):
        run_job(MatrixGame(), mixed_job(), tmp_path / "mine")


def test_a_part_without_key_is_refused(tmp_path: Path) -> None:
    path = share(mixed_job(), tmp_path)[0]
    data = tables.parquet_bytes(pl.read_parquet(path))
    path.unlink()
    path.with_name(f"{path.stem.rpartition('-')[0]}-{sha256(data)}.parquet").write_bytes(data)
    with pytest.raises(ValueError, match="1 part without a job's key"):
        run_job(MatrixGame(), mixed_job(), tmp_path)


def test_two_parts_of_one_chunk_are_refused(tmp_path: Path) -> None:
    first = share(mixed_job(), tmp_path)[0]
    relabelled(first, lambda table: table.with_columns(pl.col("return") * 2), {}, keep=True)
    with pytest.raises(ValueError, match="are the same part of the job with other episodes"):
        run_job(MatrixGame(), mixed_job(), tmp_path)
    assert first.is_file()


def test_parts_of_two_machines_name_both(tmp_path: Path) -> None:
    job = mixed_job()
    share(job, tmp_path)
    for path in share(job, tmp_path, 2)[:1]:
        machine = {**describe_machine(), "processor": "Another Processor 9000"}
        relabelled(path, lambda table: table, {"made_with": machine})
    run_job(MatrixGame(), job, tmp_path)
    made = (read_manifest(tmp_path) or {})["made_with"]
    assert "processor" not in made
    names = {machine["processor"] for machine in made["machines"]}
    assert names == {"Another Processor 9000", describe_machine()["processor"]}
    run_job(MatrixGame(), job, tmp_path / "one")
    assert (read_manifest(tmp_path / "one") or {})["made_with"] == describe_machine()


def test_merging_without_keys_would_be_caught(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: keys are not compared, and rows of another seed enter the table."""
    share(mixed_job(), tmp_path / "mine")
    share(mixed_job(seed=1), tmp_path / "theirs", 2)
    gather(tmp_path / "theirs", tmp_path / "mine")
    believed = {"job": mixed_job().digest(), "made_with": {}}
    # Planted: the label of a part is nowhere else read.
    monkeypatch.setattr(parts, "_metadata", lambda path: believed)
    keys = run_job(MatrixGame(), mixed_job(), tmp_path / "mine").table["key"]
    assert keys.n_unique() > mixed_job().episodes


def relabelled(path: Path, change: Any, about: dict[str, Any], *, keep: bool = False) -> None:
    """Write a part again with other episodes or another label, under a name that fits."""
    said = json.loads(pl.read_parquet_metadata(path)[METADATA_KEY])
    data = tables.parquet_bytes(
        change(pl.read_parquet(path)), {METADATA_KEY: json.dumps({**said, **about})}
    )
    path.with_name(f"{path.stem.rpartition('-')[0]}-{sha256(data)}.parquet").write_bytes(data)
    if not keep:
        path.unlink()
