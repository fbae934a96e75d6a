"""The whole service by its commands, in real processes: a season until its proof."""

import contextlib
import importlib
import json
import os
import queue
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.commands.opening import open_client
from assistax_board.folder import check_folder
from assistax_board.problems import Problem
from assistax_board.serve import open_service
from assistax_board.store.schema import JOB
from assistax_zoo.shell.main import run
from tests.board.fakes import new_service
from tests.board.running import port_of_its_own, soon
from tests.board.test_zoo_scorer import teams_from
from tests.untrained import ROBOT, params_of, published
from zoo.parameters.storage import write_policy_file

ROOT = Path(__file__).parents[2]


def command(*words: Any, **environment: str) -> str:
    """Run a command in a process of its own and return what it printed."""
    result = subprocess.run(
        [sys.executable, "-m", "assistax_zoo", *map(str, words)],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture
def board(tmp_path: Path) -> Iterator[dict[str, Any]]:
    """Serve a tiny registry with one local worker; SIGTERM must end it cleanly."""
    registry = published(teams_from(0, 4), tmp_path / "public")
    data = tmp_path / "board"
    options = ["--data", data, "--port", port_of_its_own(), "--registry", registry]
    options += ["--no-references"]
    process = subprocess.Popen(
        [sys.executable, "-m", "assistax_zoo", "serve", *map(str, options)],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )
    said: queue.SimpleQueue[str] = queue.SimpleQueue()
    reading = threading.Thread(target=listen, args=(process.stderr, said))
    reading.start()
    lines = iter(said.get, "")
    address, place = next(lines).split()[1], next(lines)
    token = (data / "organiser-token").read_text().strip()
    assert token not in place, "journals keep what a server prints"
    environment = {"ASSISTAX_ZOO_SERVER": address, "ASSISTAX_ZOO_TOKEN": token}
    assert soon(lambda: _answers(address), 120.0)
    answer = {"data": data, "registry": registry, "environment": environment, "place": place}
    yield {**answer, "lines": lines, "process": process}
    stop(process)
    reading.join()


def listen(pipe: Any, said: queue.SimpleQueue[str]) -> None:
    """Take what a server says, all the time: it would wait for ever where its pipe is full."""
    with pipe:
        for line in pipe:
            said.put(line)
    said.put("")


def stop(process: Any) -> None:
    """End a server; one that has ended stays as it is."""
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0


def _answers(address: str) -> bool:
    with contextlib.suppress(httpx2.TransportError):
        return httpx2.get(f"{address}/api/health").status_code == 200
    return False


def _declare_by_command(folder: Path, environment: dict[str, str]) -> None:
    """Hand in two seeds as a declared entry, and read its place."""
    seeds = [folder / f"seed{seed}.safetensors" for seed in (8, 9)]
    for number, path in enumerate(seeds, 8):
        write_policy_file(path, ROBOT, params_of(ROBOT, number))
    words = ("submit", *seeds, "--task", "scratch", "--method", "wide", "--watch")
    card = ("--steps", "10", "--partners-met", "none", "--code", "not published", "--trained", "2")
    output = command(*words, *card, **environment)
    assert output.count("place: 1 of 1 on http://127.0.0.1") == 2


@pytest.mark.slow
def test_a_season_by_its_commands(board: dict[str, Any], tmp_path: Path) -> None:
    data, environment = board["data"], board["environment"]
    private = published(teams_from(100, 4), tmp_path / "private").parent
    season, task = ("spring", "--data", data), ("--task", "scratch")
    made = command("season", "create", *season, *task, "--release", private, "--small")
    assert "season spring is made" in made and "4 partners of trained teams (4 ippo)" in made
    opened = command("season", "open", *season).splitlines()
    assert opened[0].startswith("season spring is open; announce its Merkle root: ")
    assert opened[1].startswith("it closes by itself at ")
    root = opened[0].split()[-1]
    file = tmp_path / "robot.safetensors"
    write_policy_file(file, ROBOT, params_of(ROBOT, 7))
    by = ("submit", file, *task, "--season", "spring", "--watch", "--method")
    check = ("--check", "--registry", board["registry"], "--json")
    checked = command("submit", file, *task, *check)
    assert json.loads(checked)["check"] == "admitted"
    submitted = command(*by, "mine", "--json", **environment)
    answer = json.loads(submitted)
    assert (answer["state"], answer["scores"].keys()) == ("scored", {"public", "A"})
    assert (answer["board_place"], answer["of_methods"]) == (None, 0), "a single robot has none"
    limits = command("submit", "--task", "scratch", "--limits", **environment)
    assert "attempts left on scratch, 1 made, 0 under way" in limits
    output = command(*by, "again", **environment)
    assert "place: " not in output
    assert f"mean return, public: {answer['scores']['public']['mean']:.1f}" in output
    scores = httpx2.get(f"{environment['ASSISTAX_ZOO_SERVER']}/api/boards/scratch").json()["scores"]
    public = [score["figures"] for score in scores if score["panel"] == "public"]
    assert public == [answer["scores"]["public"]] * 2, "the same robot, the same score, every bit"
    _declare_by_command(tmp_path, environment)
    (tmp_path / "receipt.json").write_text(submitted)
    key = answer["receipt"]["content"]["key"]
    command("receipt", "verify", tmp_path / "receipt.json", "--key", key)
    entered = command("season", "enter", "spring", answer["id"], "--json", **environment)
    assert [row["id"] for row in json.loads(entered)] == [answer["id"]]
    command("season", "close", *season)
    proofs: list[dict[str, Any]] = []
    assert soon(lambda: proofs.append(_proof(root, environment)) or proofs[-1], 300.0)
    assert (proofs[-1]["proved"], proofs[-1]["partners"]) == (True, 4)
    command("service", "backup", tmp_path / "board.zip", "--data", data)
    command("service", "restore", tmp_path / "board.zip", "--data", tmp_path / "again")
    tokens = json.loads(command("token", "list", "--data", tmp_path / "again", "--json"))
    assert len(tokens) == 2


def _proof(root: str, environment: dict[str, str]) -> dict[str, Any]:
    with contextlib.suppress(AssertionError):
        verify = ("season", "verify", "spring", "--root", root, "--json")
        return json.loads(command(*verify, **environment))
    return {}


def test_a_server_stops_with_its_workers(board: dict[str, Any]) -> None:
    """The fixture holds it to exit code 0, within a minute."""
    for name in ("worker-token", "organiser-token"):
        assert (board["data"] / name).stat().st_mode & 0o777 == 0o600
    assert f"`cat {board['data'] / 'organiser-token'}` prints it" in board["place"]


@pytest.mark.slow
def test_a_stop_gives_the_job_under_way_back(board: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "robot.safetensors"
    write_policy_file(file, ROBOT, params_of(ROBOT, 7))
    command("submit", file, "--task", "scratch", "--method", "mine", **board["environment"])
    assert any("job begins" in line for line in board["lines"])
    stop(board["process"])
    service = open_service(board["data"], registry=board["registry"])
    with service.database.read() as connection:
        rows = connection.execute(sa.select(JOB.state, JOB.failures)).all()
    assert [tuple(row) for row in rows] == [("waiting", 0)]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["serve", "--port", "0"], r"\(pyproject.toml\).*such as my-board"),
        (["token", "list"], "is not a service's folder"),
    ],
)
def test_no_service_is_made_beside_other_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    """A checkout has a folder `board`, which is the package."""
    (tmp_path / "pyproject.toml").touch()
    before = tmp_path.stat().st_mode
    assert run([*words, "--data", str(tmp_path)]) == 1
    assert re.search(message, capsys.readouterr().err, re.DOTALL)
    assert [path.name for path in tmp_path.iterdir()] == ["pyproject.toml"]
    assert tmp_path.stat().st_mode == before


def test_a_folder_of_a_service_is_taken_again(tmp_path: Path) -> None:
    check_folder(tmp_path / "new")
    (tmp_path / "service.db-wal").touch()  # of a start that was killed
    (tmp_path / "artefacts").mkdir()
    check_folder(tmp_path)
    (tmp_path / "notes").touch()
    with pytest.raises(ValueError, match=r"\(notes\)"):
        check_folder(tmp_path)
    open_service(tmp_path)
    check_folder(tmp_path)


def test_an_empty_token_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ASSISTAX_ZOO_TOKEN", "")
    with TestClient(create_app(new_service(tmp_path / "board"))) as http:
        client = Client("http://testserver", open_client(None, None).token, transport=http)
        with pytest.raises(Problem, match="ASSISTAX_ZOO_TOKEN is empty"):
            client.limits()
        with pytest.raises(Problem, match="this token is not valid"):
            Client("http://testserver", "azt_no", transport=http).limits()
    (tmp_path / "token").touch()
    with pytest.raises(ValueError, match="token is empty"):
        open_client(None, tmp_path / "token")


@pytest.mark.parametrize(
    ("module", "place", "extra"),
    [
        ("psycopg", {"database": "postgresql+psycopg://nobody@127.0.0.1:1/x"}, "postgres"),
        ("s3fs", {"artefacts": "s3://bucket/path"}, "s3"),
    ],
)
def test_missing_extra_names_its_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, place: Any, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    # fsspec keeps what was opened once, in other tests too, and asks for no module again.
    kept = importlib.import_module("fsspec.registry")._registry
    monkeypatch.delitem(kept, extra, raising=False)
    with pytest.raises(ValueError, match=rf"pip install 'assistax-zoo-board\[{extra}\]'"):
        open_service(tmp_path, **place)
