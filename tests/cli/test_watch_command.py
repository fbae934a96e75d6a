"""`assistax-zoo watch`: a window where there is a display, else a page, or one line why not."""

import contextlib
import importlib
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import assistax_zoo as az
from assistax_zoo.shell.main import run
from evaluation.figures.saved_tables import save_crossplay
from evaluation.record import tables
from evaluation.record.manifest import write_manifest
from evaluation.record.record import Record
from tests.evaluation.episode_tables import CONTEXT, episode_table, team_id, teams

STEPS = ("--steps", "4")


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
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
def test_without_a_display_a_page_is_written(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["watch", "scratch", "random", "zero", *STEPS]) == 0
    assert capfd.readouterr().out == "watch.html\n"
    text = (tmp_path / "watch.html").read_text(encoding="utf-8")
    assert "An episode of scratch" in text and "data-autoplay" in text
    assert [path.name for path in tmp_path.iterdir()] == ["watch.html"]


def test_a_recording_is_played_and_written_for_other_pages(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["watch", str(recording), "--out", "new/x.episode"]) == 0
    assert run(["watch", str(recording), "--out", "x.html"]) == 0
    assert capfd.readouterr().out == "new/x.episode\nx.html\n"
    assert (tmp_path / "new" / "x.episode").stat().st_size < 400_000
    assert (tmp_path / "x.html").stat().st_size < 1_000_000


def test_with_a_display_a_window_opens(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_display_that_is_named_and_not_there_gives_a_page(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":4711")
    assert run(["watch", str(recording)]) == 0
    assert (tmp_path / "watch.html").is_file()


def test_a_report_records_and_plays_the_pair_that_earns_least(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, asked = tmp_path / "xp", []
    returns = np.array([[[5.0], [1.0]], [[4.0], [3.0]]])
    save_crossplay(Record(episode_table(returns, teams(2), teams(2)), folder), CONTEXT)
    tables.write_episodes(episode_table(returns, teams(2), teams(2)), folder / tables.EPISODES_FILE)
    identity = {"task": "scratch", "seed": 7, "apart": True, "egos": [], "partners": []}
    write_manifest(folder, {"identity": identity})

    def recorded(robot: str, human: str, *, out: Path, **options: Any) -> None:
        asked.append((robot, human, options["seed"], options["task"]))
        shutil.copy(recording, out)

    monkeypatch.setattr("assistax_zoo.recording.trajectories", recorded)
    for words, episodes in (((), 0), (("--watch",), 1), ((), 1)):  # once recorded, it stays
        assert run(["report", str(folder), "--out", "page.html", *words]) == 0
        text = (tmp_path / "page.html").read_text(encoding="utf-8")
        assert text.count("data-episode=") == episodes
    names = [
        f"{team_id(team)}/{role}" for team, role in zip(teams(2), ("robot", "human"), strict=True)
    ]
    assert asked == [(*names, 7, "scratch")]
    (folder / "worst.trajectory").write_bytes(b"no recording")
    assert run(["report", str(folder), "--out", "page.html"]) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("scratch", "zero"), "scratch has a robot and no human; give both"),
        (("gone.trajectory",), "there is no file gone.trajectory"),
        (("gone.trajectory", "--preference", "p1"), "leave out preference"),
        (("gone.trajectory", "--steps", "2", "--seed", "1"), "leave out steps, seed"),
        (("scratch", "zero", "zero", "--out", "x.gif"), "x.gif ends in '.gif'; allowed are .html"),
        (("scratch", "zero", "zero", "--episode", "2"), "episode is for recordings"),
        (("scratch", "zero", "best"), "policy 'best' has an unknown form"),
        (("swim", "zero", "zero"), "task is 'swim'; allowed are scratch"),
        (("scratch", "zero", "zero", "--steps", "0"), "steps is 0; allowed are 1 to 1000"),
    ],
)
def test_wrong_words_get_one_line(
    words: tuple[str, ...], message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["watch", *words]) == 1
    printed = capfd.readouterr()
    assert printed.out == "" and printed.err.startswith("error: ")
    assert message in printed.err and printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
