"""Films of robots that were handed in: with a published partner alone, and gone with the file."""

import functools
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_base.digest import sha256
from assistax_board import pages
from assistax_board.app import create_app
from assistax_board.pages import videos
from assistax_board.pages.rendering import PLAYER, static_address
from assistax_board.pages.security import FIELD
from assistax_board.pages.videos import ROBOT, HandedIn, Videos, film_command, watch_command
from assistax_board.service import Service
from assistax_zoo.shell.main import run
from tests.board.fakes import TASK, draft, new_service, new_submitter, work_off
from tests.board.test_pages import Films, form_token
from tests.board.test_season import open_season
from zoo.registry import load_registry


class Seen(Films):
    """Films, and keeps what it read of the robot's file."""

    def __init__(self) -> None:
        super().__init__()
        self.robots: list[tuple[str, bytes]] = []

    def __call__(self, arguments: Sequence[str], folder: Path) -> None:
        robot = arguments[arguments.index("--robot") + 1 if "--robot" in arguments else 1]
        self.robots.append((robot, (folder / robot).read_bytes()))
        super().__call__(arguments, folder)


@pytest.fixture
def service(tmp_path: Path) -> Service:
    return new_service(tmp_path / "board")


@pytest.fixture
def films(monkeypatch: pytest.MonkeyPatch) -> Seen:
    """Stands for the command line."""
    seen = Seen()
    monkeypatch.setattr(pages, "run_command", lambda words, folder, registry: seen(words, folder))
    return seen


@pytest.fixture
def reader(tmp_path: Path, service: Service, films: Seen) -> Iterator[TestClient]:
    with TestClient(create_app(service, films=tmp_path / "board" / "films")) as client:
        yield client


def ask(reader: TestClient, id: str) -> Any:
    address = f"/submissions/{id}/film"
    return reader.post(address, data={FIELD: form_token(reader, address)})


def wait(reader: TestClient, id: str) -> str:
    while "The film is" in (page := reader.get(f"/submissions/{id}/film").text):
        pass
    return page


def scored(service: Service, strength: float = 1.0, **fields: Any) -> str:
    name = f"lab {strength}"
    fields = {"licence": "MIT", **fields}
    id = service.submit(new_submitter(service, name), draft(strength, f"r{strength}", **fields))
    work_off(service)
    return id


def test_robot_film_uses_a_training_partner(
    tmp_path: Path, service: Service, films: Seen, reader: TestClient
) -> None:
    id = scored(service, season=open_season(service))
    assert f"/submissions/{id}/film" in reader.get(f"/submissions/{id}").text
    assert f"/submissions/{id}/film/file" not in reader.get(f"/submissions/{id}/method").text
    assert ask(reader, id).status_code == 200
    assert f'src="/submissions/{id}/film/file"' in wait(reader, id)
    ask_again = reader.post(f"/submissions/{id}/film", data={FIELD: "wrong"})
    assert ask_again.status_code == 403
    command, watched = films.commands
    name = f"{sha256(b'robot 1.0')[:12]}.onnx"
    assert films.robots == 2 * [(name, b"robot 1.0")], "shown is this, and no folder of the server"
    human = command[command.index("--human") + 1].removeprefix("zoo:")
    words = str(films.commands).replace(str(tmp_path), "")
    assert "secret" not in words and "hidden" not in words, "no partner of the season"
    assert watched[:5] == ["watch", name, f"zoo:{human}", "--task", TASK]
    registry = load_registry()
    assert registry.split(TASK).side(registry.policy(human).team) == "train"
    film = reader.get(f"/submissions/{id}/film/file")
    assert film.content == b"film" and film.headers["Cache-Control"] == "no-cache"
    episode = reader.get(f"/submissions/{id}/film/episode")
    assert episode.content == b"episode" and episode.headers["Cache-Control"] == "no-cache"
    page = reader.get(f"/submissions/{id}/film").text
    assert f'data-episode-from="/submissions/{id}/film/episode"' in page
    assert all(f'src="{static_address(script)}"' in page for script in PLAYER)
    [folder] = (tmp_path / "board" / "films").iterdir()
    assert folder.name.startswith(ROBOT)
    for address in (f"/films/{folder.name}", f"/films/{folder.name}/episode"):
        assert reader.get(address).status_code == 404, "it may have to go"
    assert "<figure>" not in reader.get("/").text, "the home page shows published pairs"


def test_what_may_not_be_filmed_is_not(service: Service, reader: TestClient) -> None:
    private = scored(service, 2.0, licence="evaluation-only")
    service.add_references()
    work_off(service)
    reference = next(row.id for row in service.queries.submissions() if row.kind == "reference")
    waiting = service.submit(new_submitter(service), draft(3.0, licence="MIT"))
    reasons = {
        private: "allows scoring alone",
        reference: "no published robot",
        waiting: "Only robots",
    }
    for id, why in reasons.items():
        for answer in (
            reader.get(f"/submissions/{id}/film"),
            reader.post(f"/submissions/{id}/film", data={FIELD: "x"}),
            reader.get(f"/submissions/{id}/film/file"),
            reader.get(f"/submissions/{id}/film/episode"),
        ):
            assert answer.status_code == 404 and why in answer.text
        assert f"/submissions/{id}/film" not in reader.get(f"/submissions/{id}").text


def test_a_film_goes_with_its_robot(
    tmp_path: Path, service: Service, films: Seen, reader: TestClient
) -> None:
    ids = [scored(service, strength) for strength in (1.0, 2.0)]
    for id in ids:
        ask(reader, id)
        wait(reader, id)
    service.withdraw(ids[0], new_submitter(service, "lab 1.0"))
    for kind in ("file", "episode"):
        assert reader.get(f"/submissions/{ids[0]}/film/{kind}").status_code == 404
    folder = tmp_path / "board" / "films"
    assert len(list(folder.iterdir())) == 2
    assert run(["service", "erase", "lab 2.0", "--data", str(tmp_path / "board")]) == 0
    assert reader.get(f"/submissions/{ids[1]}/film/file").status_code == 404
    assert list(folder.iterdir()) == []
    assert "not here any more" in reader.get(f"/submissions/{ids[1]}/film").text


def shortened(command: Callable[..., list[str]], *seats: Any) -> list[str]:
    return [*command(*seats), "--steps", "16"]


@pytest.mark.slow
def test_an_onnx_file_is_really_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of a second of it, by the command line."""
    for name, command in (("film_command", film_command), ("watch_command", watch_command)):
        shorter = functools.partial(shortened, command)
        monkeypatch.setattr(videos, name, shorter)
    file, human = tmp_path / "robot.onnx", load_registry().policy("scratch/ippo-d1-s1-v1/human")
    words = ["export", "scratch/ppo-ego-s0-v1/robot", "--format", "onnx", "--out", str(file)]
    assert run(words) == 0
    data = file.read_bytes()
    filmed = HandedIn(TASK, sha256(data), human.id, human.sha256, 1, lambda _: data)
    made = Videos(tmp_path / "films")
    made.ask(filmed)
    made.wait()
    film = made.film(filmed.key)
    assert film is not None and film.stat().st_size > 1000
    names = sorted(path.name for path in film.parent.iterdir())
    assert names == [film.name, "shown.episode"], "the file stays nowhere"
    content = json.loads(zlib.decompress((film.parent / "shown.episode").read_bytes()))
    assert len(content["poses"]) == 17 and content["robot"].endswith(".onnx")
