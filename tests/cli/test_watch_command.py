"""`assistax-zoo watch`: a window where there is a display, else a page, or one line why not."""

import contextlib
import importlib
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import polars as pl
import pytest

import assistax_zoo as az
from assistax_zoo.shell.main import run
from evaluation.figures.saved_tables import save_crossplay
from evaluation.record import tables
from evaluation.record.manifest import file_sha256, identity_digest, seal, write_manifest
from evaluation.record.record import Record
from population.networks.spec import ROLES
from tests.evaluation.episode_tables import CONTEXT, episode_table, team_id, teams
from tests.untrained import halved, published, teams_of
from zoo.registry import Registry, load_registry

STEPS = ("--steps", "4")


@pytest.fixture(autouse=True)
def no_display(monkeypatch, tmp_path: Path) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("pair") / "pair.trajectory"
    options = {"episodes": 1, "steps": 4, "backend": "native"}
    az.trajectories("random", "zero", task="scratch", out=out, **options)
    return out


class Window:
    """Stands for MuJoCo's window: closed after so many frames, it keeps what it was given."""

    def __init__(self, frames: int) -> None:
        self.left, self.poses, self.marks = frames, [], []
        self.cam = mujoco.MjvCamera()
        self.user_scn = SimpleNamespace(ngeom=0, geoms=[mujoco.MjvGeom() for _ in range(100)])

    def launch_passive(self, model: Any, data: Any, key_callback: Any, **panels: bool) -> Any:
        assert not any(panels.values())
        self.model, self.data, self.press = model, data, key_callback
        return contextlib.nullcontext(self)

    def is_running(self) -> bool:
        self.left -= 1
        return self.left >= 0

    def lock(self) -> contextlib.nullcontext[None]:
        return contextlib.nullcontext()

    def sync(self) -> None:
        self.poses.append(np.array(self.data.qpos))
        self.marks.append(self.user_scn.ngeom)


@pytest.mark.slow
def test_without_a_display_a_page_is_written(tmp_path: Path, capfd) -> None:
    assert run(["watch", "random", "zero", "--task", "scratch", *STEPS]) == 0
    assert capfd.readouterr().out == "watch.html\n"
    text = (tmp_path / "watch.html").read_text(encoding="utf-8")
    assert "An episode of scratch" in text and "data-autoplay" in text
    assert [path.name for path in tmp_path.iterdir()] == ["watch.html"]


def test_a_recording_is_played_and_written_for_other_pages(
    recording: Path, tmp_path: Path, capfd
) -> None:
    assert run(["watch", str(recording), "--out", "new/x.episode"]) == 0
    assert run(["watch", str(recording), "--out", "x.html"]) == 0
    assert capfd.readouterr().out == "new/x.episode\nx.html\n"
    assert (tmp_path / "new" / "x.episode").stat().st_size < 400_000
    assert (tmp_path / "x.html").stat().st_size < 1_000_000


def test_with_a_display_a_window_opens(recording: Path, tmp_path: Path, monkeypatch) -> None:
    window, find = Window(3), importlib.import_module
    display = SimpleNamespace(init=lambda: True, terminate=lambda: None)
    fakes = {"mujoco.viewer": window, "glfw": display}
    monkeypatch.setattr(importlib, "import_module", lambda name: fakes.get(name) or find(name))
    monkeypatch.setenv("DISPLAY", ":0")
    assert run(["watch", str(recording)]) == 0
    assert len(window.poses) == 3 and list(tmp_path.iterdir()) == []
    assert min(window.marks) >= 1, "the itch is marked"
    assert window.model.nq == len(window.poses[0])
    assert run(["watch", str(recording), "--out", "x.html"]) == 0, "who asks for a page has one"
    assert (tmp_path / "x.html").is_file()
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DISPLAY", ":4711")
    assert run(["watch", str(recording)]) == 0, "a display that is named and not there"
    assert (tmp_path / "watch.html").is_file()


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    return load_registry(published(teams_of(2), tmp_path_factory.mktemp("zoo")))


def finished(folder: Path, zoo: Registry, robot: str = "", digest: str = "") -> Path:
    """Return a sealed cross-play of two teams, of which the first robot may be called otherwise."""
    returns = np.array([[[5.0], [1.0]], [[4.0], [3.0]]])
    table = episode_table(returns, teams(2), teams(2))
    worst = table["ego"][0]
    table = table.with_columns(pl.col("ego").replace(worst, robot or worst))
    save_crossplay(Record(table, folder), CONTEXT)
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    robots, humans = ([f"{team_id(team)}/{role}" for team in teams(2)] for role in ROLES)
    egos = [[name, zoo.policy(name).sha256] for name in robots if name != worst]
    first = [robot or worst, digest or zoo.policy(worst).sha256]
    identity: dict[str, Any] = {"task": "scratch", "seed": 7, "apart": True}
    identity["env_version"] = zoo.env_version(zoo.policies[0])
    identity["egos"] = [first, *egos]
    identity["partners"] = [[name, "d1", None, zoo.policy(name).sha256, None] for name in humans]
    write_manifest(folder, {"identity": identity, "job": identity_digest(identity)})
    seal(folder)
    return folder


@pytest.fixture
def asked(recording: Path, monkeypatch) -> list[Any]:
    """Stands for the simulation: notes which pair is played, and gives another's recording."""
    pairs: list[Any] = []

    def recorded(robot: str, human: str, *, out: Path, **options: Any) -> None:
        pairs.append((robot, human, options["seed"], options["task"]))
        shutil.copy(recording, out)

    monkeypatch.setattr("assistax_zoo.recording.trajectories", recorded)
    return pairs


def report(folder: Path, zoo: Registry, *words: str) -> int:
    return run(["report", str(folder), "--out", "page.html", "--registry", str(zoo.path), *words])


def test_a_report_plays_the_pair_that_earns_least(
    zoo: Registry, tmp_path: Path, asked: list[Any]
) -> None:
    folder = finished(tmp_path / "xp", zoo)
    before = {path.name for path in folder.iterdir()}
    for words, episodes in (((), 0), (("--watch",), 1)):
        assert report(folder, zoo, *words) == 0
        text = (tmp_path / "page.html").read_text(encoding="utf-8")
        assert text.count("data-episode=") == episodes
    names = [f"{team_id(team)}/{role}" for team, role in zip(teams(2), ROLES, strict=True)]
    assert asked == [(*names, 7, "scratch")]
    assert {path.name for path in folder.iterdir()} == before


def test_a_page_plays_no_recording_that_it_was_given(zoo: Registry, tmp_path: Path) -> None:
    """Any file may call itself an episode of any pair."""
    folder = finished(tmp_path / "xp", zoo)
    (folder / "worst.trajectory").write_bytes(b"no recording")
    assert report(folder, zoo) == 0
    assert "data-episode=" not in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ("python:os:getcwd", "is code, and the folder names it; read it, then allow run_code"),
        ("python:robot.py:make", "is code, and the folder names it"),
        ("object:Net-0", "was a Python object, which no file holds"),
        ("{elsewhere}", "is a file outside the folder, and the folder names it"),
        ("robot.safetensors", "is a file outside the folder, and the folder names it"),
        ("../robot.safetensors", "is a file outside the folder, and the folder names it"),
        ("scratch/*/robot", "scratch/.*/robot"),
    ],
)
def test_a_received_name_runs_and_reads_nothing_outside(
    zoo: Registry, tmp_path: Path, asked: list[Any], capsys, robot: str, message: str
) -> None:
    """A policy file of that name lies in the reader's folder, and is not taken."""
    place = tmp_path / "robot.safetensors"
    az.open_zoo(zoo.path).export("scratch/ippo-d1-s0-v0/robot", place)
    (tmp_path / "robot.py").write_text("raise SystemExit('it runs')")
    name = robot.format(elsewhere=place)
    digest = file_sha256(place)
    folder = finished(tmp_path / "xp", zoo, name, digest)
    assert report(folder, zoo, "--watch") == 1
    assert re.search(message, " ".join(capsys.readouterr().err.split()))
    assert asked == []
    if name == str(place):  # the reader may trust the names of a folder
        assert report(folder, zoo, "--watch", "--run-code") == 0
        assert asked[-1][0] == name
    if name.endswith("robot.safetensors"):  # a copy within the folder is taken
        shutil.copy(place, folder)
        assert report(folder, zoo, "--watch") == 0
        assert asked[-1][0] == str(folder / "robot.safetensors")


def test_a_pair_of_another_registry_is_not_played(
    zoo: Registry, tmp_path: Path, asked: list[Any], capsys
) -> None:
    """With the same ids and other parameters."""
    folder = finished(tmp_path / "xp", zoo)
    other = load_registry(published(halved(teams_of(2)), tmp_path / "other"))
    assert report(folder, other, "--watch") == 1
    assert "is not the one that played" in " ".join(capsys.readouterr().err.split())
    assert asked == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("zero", "no recording is at zero; give a robot and a human"),
        ("gone.trajectory", "no recording is at gone.trajectory"),
        ("there.trajectory --preference p1", "leave out preference"),
        ("there.trajectory --steps 2 --seed 1", "leave out steps, seed"),
        ("zero zero --task scratch --out x.gif", "x.gif ends in '.gif'; allowed are .html"),
        ("zero zero --task scratch --episode 2", "episode is for recordings"),
        ("zero best --task scratch", "policy 'best' has an unknown form"),
        ("zero zero --task swim", "task is 'swim'; allowed are scratch"),
        ("zero zero --task scratch --steps 0", "steps is 0; allowed are 1 to 1000"),
    ],
)
def test_wrong_words_get_one_line(words: str, message: str, tmp_path: Path, capfd) -> None:
    Path("there.trajectory").touch()
    assert run(["watch", *words.split()]) == 1
    printed = capfd.readouterr()
    assert printed.out == "" and printed.err.startswith("error: ")
    assert message in printed.err and printed.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there.trajectory"]
