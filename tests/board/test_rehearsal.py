"""A whole tiny season by one command, and what would make it fail."""

from pathlib import Path

import pytest

from assistax_board import rehearsal
from assistax_zoo.shell.main import run
from tests.untrained import published, teams_of


@pytest.mark.slow
def test_a_season_is_rehearsed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    registry = published(teams_of(4), tmp_path / "public")
    data = tmp_path / "rehearsal"
    words = ["season", "rehearse", "--data", str(data), "--registry", str(registry)]
    assert run(words) == 0, capsys.readouterr().err
    lines = capsys.readouterr().out
    for text in (
        "trained 4 hidden teams",
        "its root is ",
        "Lab of Ada handed in robot.safetensors",
        "Lab of Grace handed in robot.onnx",
        "connected a live robot",
        "the closing date came",
        "proved: the 4 partners",
        "panel B: ",
        "are a chain",
        "a backup has",
        "has stopped",
    ):
        assert text in lines
    assert (data / "board.zip").is_file()
    assert run(words) == 1 and "exists; name a new folder" in capsys.readouterr().err


def test_what_never_happens_ends_a_rehearsal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "LIMIT_SECONDS", 0.0)
    with pytest.raises(ValueError, match="in vain: the moon falls"):
        rehearsal.wait("the moon falls", lambda: False)
