"""No test begins once TESTS_UNTIL is over; `tests/conftest.py` holds them to that."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

TEST = """import os

def test_it(): assert "TESTS_UNTIL" not in os.environ
"""
OPTIONS = ["-v", "--import-mode=importlib"]
OPTIONS += [f"-pno:{name}" for name in ("schemathesis", "cacheprovider", "faulthandler", "xdist")]
FILES = 5


def run(folder: Path, until: float, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run a test in each of some files until a moment; return the exit code."""
    conftest = sys.modules["tests_conftest"]
    monkeypatch.setattr(conftest, "UNTIL", until)
    monkeypatch.setenv("TESTS_UNTIL", str(until))
    for number in range(FILES):
        (folder / f"test_{number}.py").write_text(TEST)
    return int(pytest.main([*OPTIONS, f"--rootdir={folder}", str(folder)], plugins=[conftest]))


def test_no_test_begins_without_time(tmp_path: Path, capsys, monkeypatch) -> None:
    assert run(tmp_path, time.time() - 1.0, monkeypatch) == pytest.ExitCode.OK
    out = capsys.readouterr().out
    assert f"no time was left for {FILES} tests: run them without TESTS_UNTIL" in out
    assert f"{FILES} skipped" in out


def test_files_begin_at_a_place_of_the_commit(tmp_path: Path, capsys, monkeypatch) -> None:
    commit = subprocess.CompletedProcess((), 0, stdout="8\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: commit)
    assert run(tmp_path, time.time() + 600.0, monkeypatch) == pytest.ExitCode.OK
    out = capsys.readouterr().out
    assert f"{FILES} passed" in out and "no time" not in out
    assert re.findall(r"test_(\d)\.py::test_it PASSED", out) == ["3", "4", "0", "1", "2"]
