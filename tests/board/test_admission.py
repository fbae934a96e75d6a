"""What `submit --check` says at home is what the server says, word for word."""

from collections import Counter
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_board import submitting
from assistax_board.problems import Problem, Refusal
from assistax_board.robots.admission import Admission, robot_sizes
from assistax_board.rules.submissions import Admitted
from assistax_board.service import Service
from assistax_board.work.zoo_scorer import ZooScorer
from tests.board.fakes import draft, new_service, new_submitter, shown
from tests.board.robot_files import COUNT, GOOD, KINDS, robot_files
from tests.untrained import published, teams_of
from zoo.registry import load_registry

TASK = "scratch"


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return published(teams_of(2), tmp_path_factory.mktemp("public"))


@pytest.fixture
def server(tmp_path: Path, registry: Path) -> Service:
    service = new_service(tmp_path)
    object.__setattr__(service, "admit", Admission(robot_sizes(load_registry(registry))))
    return service


def at_home(path: Path, registry: Path) -> str:
    try:
        return submitting.check_file(path, TASK, registry)["format"]
    except Refusal as refusal:
        return refusal.code


def at_the_server(service: Service, submitter: str, request: str, data: bytes) -> str:
    """Return the format of what was let in, or the word by which it was refused."""
    try:
        id = service.submit(submitter, draft(data=data, request=request))
    except Problem as problem:
        return problem.code
    submission = shown(service, id)
    if submission.reason is not None:
        return submission.reason
    admitted = service.admit(service.artefacts.get(str(submission.artefact)), TASK)
    assert submission.state == "queued"
    return admitted.format


def disagreements(service: Service, registry: Path, path: Path) -> tuple[list[Any], Counter[str]]:
    """Return the files about which home and server disagree, and how often each word came."""
    submitter, wrong, words = new_submitter(service), [], Counter()
    for number, (kind, data) in enumerate(robot_files()):
        path.write_bytes(data)
        answers = at_home(path, registry), at_the_server(service, submitter, str(number), data)
        words[answers[1]] += 1
        admitted = answers[1] in ("safetensors", "onnx")
        if answers[0] != answers[1] or (kind in GOOD and not admitted):
            wrong.append((number, kind, answers))
    return wrong, words


@pytest.mark.slow
def test_home_and_server_admit_alike(
    server: Service, registry: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ZooScorer, "play", lambda *_: _nothing())
    wrong, words = disagreements(server, registry, tmp_path / "robot.file")
    assert wrong == []
    assert (words.total(), len(KINDS)) == (COUNT, 43)
    assert words["safetensors"] >= COUNT // 13 and words["onnx"] >= COUNT // 13
    assert len(words) >= 14, words  # two formats, and most words of the vocabulary


def test_laxer_home_check_is_found(
    server: Service, registry: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ZooScorer, "play", lambda *_: _nothing())
    monkeypatch.setattr(submitting, "Admission", lambda sizes: lambda data, task: Admitted("onnx"))
    path = tmp_path / "robot.file"
    path.write_bytes(b"\x80pickle")
    assert at_home(path, registry) == "onnx"
    assert at_the_server(server, new_submitter(server), "1", path.read_bytes()) == "unknown_format"


def _nothing() -> pl.DataFrame:
    row = {"partner": ["p"], "episode": [0], "return": [0.0], "nonfinite": [False]}
    return pl.DataFrame(row)
