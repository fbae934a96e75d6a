"""A whole tiny season by one command, and what would make it fail."""

import contextlib
import errno
import re
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest

from assistax_board import rehearsal
from assistax_zoo.shell.main import run
from tests.attack.test_faults import mounted
from tests.untrained import gentle_specs, published, teams_of

TASK = "gentle_scratch"
Rehearse = Callable[[rehearsal.Stage], Iterator[str]]


@pytest.mark.slow
def test_a_season_is_rehearsed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rehearsal, "rehearse", on_a_disk_that_fills_up(rehearsal.rehearse))
    registry = published(teams_of(4, *gentle_specs(TASK), TASK), tmp_path / "public")
    data = tmp_path / "rehearsal"
    words = ["season", "rehearse", "--data", str(data), "--registry", str(registry)]
    words += ["--minutes", "2.5"]  # the disk is full for a part of them
    assert run(words) == 0, capsys.readouterr().err
    lines = capsys.readouterr().out
    stages = re.findall(r"stage (\d) of 6, ", lines)
    assert stages == list("123456")
    assert lines.count("panel B: ") == 2
    for text in (
        "trained 4 hidden teams",
        "drew 4 hidden persons from a secret",
        "its root is ",
        "Lab of Ada handed in robot.safetensors",
        "Lab of Grace handed in robot.onnx",
        "upgraded while the season is open: fused plays anew what native scored",
        "the closing date came",
        "killed the server while the season closes",
        "a server on native does not start",
        "proved: the 8 partners",
        "are a chain",
        "a backup has",
        "has stopped",
    ):
        assert text in lines
    assert (data / "board.zip").is_file()
    assert run(words) == 1 and "exists; name a new folder" in capsys.readouterr().err


def on_a_disk_that_fills_up(rehearse: Rehearse) -> Rehearse:
    """Let it be on a real file system of 64 MB, full while robots play and the season closes."""

    def rehearse_there(stage: rehearsal.Stage) -> Iterator[str]:
        with mounted(stage.data, "size=64m") as is_there:
            for line in rehearse(stage):
                yield line
                if is_there and ("Lab of Grace handed in" in line or "the server goes on" in line):
                    with full_disk(stage.data):
                        time.sleep(15.0)
            assert is_there == (stage.data.stat().st_dev != stage.folder.stat().st_dev)

    return rehearse_there


@contextlib.contextmanager
def full_disk(folder: Path) -> Generator[None]:
    """Leave no byte on the file system of a folder, also where something is given back."""
    path, refused = folder / "filler", 0
    with path.open("wb", buffering=0) as file:
        for _ in range(3):
            try:
                while True:
                    file.write(bytes(4096))
            except OSError as error:
                refused += error.errno == errno.ENOSPC
            time.sleep(0.5)
    assert refused == 3
    yield
    path.unlink()


def test_what_never_happens_ends_a_rehearsal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "LIMIT_SECONDS", 0.0)
    with pytest.raises(ValueError, match="in vain: the moon falls"):
        rehearsal.wait("the moon falls", lambda: False)
