"""`assistax-zoo render`: films and strips of an episode, or one clear line why not."""

import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from assistax_envs.drawing import gl
from assistax_zoo.shell.main import run
from evaluation import film
from tests.untrained import ROBOT, params_of
from zoo.parameters.storage import write_policy_file

SMALL = ("--width", "160", "--height", "120")


def call(*words: object, robot="random", human: object = "zero", task: str = "scratch") -> int:
    players = ["--robot", str(robot), "--human", str(human)]
    return run(["render", "--task", task, *players, *map(str, words)])


def failure(capfd, code: int) -> str:
    printed = capfd.readouterr()
    assert code == 1
    assert printed.out == ""
    assert printed.err.startswith("error: ") and printed.err.count("\n") == 1
    return printed.err


def test_a_png_has_four_moments_two_by_two(tmp_path: Path, capfd):
    out = tmp_path / "new" / "strip.png"
    assert call("--out", out, "--steps", 20, *SMALL) == 0
    assert capfd.readouterr().out == f"{out}\n"
    strip = np.asarray(Image.open(out))
    assert strip.shape == (2 * 120, 2 * 160, 3)
    moments = [pane for row in np.split(strip, 2) for pane in np.split(row, 2, axis=1)]
    assert all((picture != other).any() for picture, other in itertools.pairwise(moments))
    assert film.moments(20) == [1, 5, 11, 20] and film.moments(1) == [0, 1]
    assert [path.name for path in out.parent.iterdir()] == ["strip.png"]


@pytest.mark.parametrize("ending", ["gif", "webp"])
@pytest.mark.slow
def test_film_of_policy_file_runs_in_real_time(tmp_path: Path, ending: str):
    path, out = tmp_path / "robot.safetensors", tmp_path / f"film.{ending}"
    write_policy_file(path, ROBOT, params_of(ROBOT, 0))
    words = ("--out", out, "--steps", 20, "--fps", 10, "--camera", "close", *SMALL)
    assert call(*words, robot=path) == 0
    with Image.open(out) as film:
        film.load()  # a .webp tells a frame's time with the frame
        assert (getattr(film, "n_frames", 1), film.info["duration"]) == (5, 100)
        assert film.size == (160, 120)


@pytest.mark.slow
def test_a_sheet_and_a_gif_lie_beside_an_mp4(tmp_path: Path):
    pytest.importorskip("imageio_ffmpeg")
    assert call("--out", tmp_path / "film.mp4", "--steps", 40, "--sheet", *SMALL) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.gif", "film.mp4", "film.png"]
    with Image.open(tmp_path / "film.gif") as moving:
        assert (getattr(moving, "n_frames", 1), moving.info["duration"]) == (21, 40)
    sheet = np.asarray(Image.open(tmp_path / "film.png"))
    assert sheet.shape == (3 * 120, 4 * 160, 3)
    panes = [pane for row in np.split(sheet, 3) for pane in np.split(row, 4, axis=1)]
    assert all((picture != other).any() for picture, other in itertools.pairwise(panes))
    assert call("--out", tmp_path / "short.png", "--steps", 2, "--sheet", *SMALL) == 0
    assert np.asarray(Image.open(tmp_path / "short.png")).shape == (2 * 120, 2 * 160, 3)


@pytest.mark.slow
def test_an_mp4_holds_every_frame(tmp_path: Path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "film.mp4"
    assert call("--out", out, "--steps", 20, "--fps", 50, *SMALL) == 0
    words = ["-i", out, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), *words]
    raw = subprocess.run(command, check=True, capture_output=True)
    assert "50 fps" in raw.stderr.decode()
    frames = np.frombuffer(raw.stdout, np.uint8).reshape(-1, 120, 160, 3)
    assert len(frames) == 21 and frames.std() > 20.0


@pytest.mark.slow
def test_the_same_seed_gives_the_same_picture(tmp_path: Path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        assert call("--out", tmp_path / f"{name}.png", "--steps", 4, "--seed", seed, *SMALL) == 0
    contents = {name: (tmp_path / f"{name}.png").read_bytes() for name in "abc"}
    assert contents["a"] == contents["b"] != contents["c"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--out x.avi", "x.avi ends in '.avi'; pictures are written as .mp4, .gif, .webp, .png"),
        ("--out x", "x ends in 'nothing'"),
        ("--out x.gif --fps 30", "fps is 30; allowed are 1, 2, 5, 10, 25, 50"),
        ("--out x.png --steps 0", "steps is 0; allowed are 1 to 1000"),
        ("--out x.png --steps 1001", "steps is 1001; allowed are 1 to 1000"),
        ("--out x.png --camera up", "camera is 'up'; allowed are"),
        ("--out x.png --width 3", "width is 3; allowed are 16 to 4096"),
        ("--out x.png --disability d10", "disability setting is 'd10'; allowed are d1"),
        ("--out x.mp4 --width 161 --height 120", "size is 161x120; an .mp4 needs an even width"),
        ("--out x.png --robot best", "policy 'best' has an unknown form; allowed are an id"),
        ("--out x.png --human zoo:scratch/ippo-d1-s0-v99", "unknown policy 'scratch/ippo-d1-s0-v"),
        ("--out x.png --task swim", "task is 'swim'; allowed are scratch"),
    ],
)
def test_wrong_values_get_one_line(words: str, message: str, tmp_path: Path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    defaults = {"--task": "scratch", "--robot": "random", "--human": "zero", "--steps": "2"}
    missing = [word for option in defaults.items() if option[0] not in words for word in option]
    assert message in failure(capfd, run(["render", *words.split(), *missing]))
    assert list(tmp_path.iterdir()) == []


def test_missing_package_or_opengl_is_named(tmp_path: Path, capfd, monkeypatch):
    def broken(width: int, height: int):
        raise gl.RenderError(f"this machine cannot draw; apt-get install {gl.PACKAGES}")

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    message = failure(capfd, call("--out", tmp_path / "x.mp4"))
    assert "pip install 'assistax-zoo[video]', or write .gif" in message
    monkeypatch.setattr("assistax_envs.drawing.render.open_context", broken)
    message = failure(capfd, call("--out", tmp_path / "x.png", "--steps", 2))
    assert "apt-get install libegl1" in message
    assert list(tmp_path.iterdir()) == []


def test_unwritable_place_is_refused_before_work(tmp_path: Path, capfd, monkeypatch):
    monkeypatch.setattr("assistax_envs.make", lambda *_: pytest.fail("work was done"))
    (tmp_path / "file").touch()
    assert "x.png cannot be written" in failure(capfd, call("--out", tmp_path / "file" / "x.png"))
    (tmp_path / "folder.gif").mkdir()
    message = failure(capfd, call("--out", tmp_path / "folder.gif"))
    assert "folder.gif cannot be written (it is a folder)" in message


def test_human_plays_under_the_named_preference(tmp_path: Path, capfd, monkeypatch):
    liked = []

    def played(*args: object, preference: str, **options: object):
        liked.append(preference)
        return film_play(*args, preference=preference, **options)

    film_play = film.play
    monkeypatch.setattr(film, "play", played)
    out = tmp_path / "strip.png"
    words = ("--out", out, "--steps", 2, *SMALL, "--preference")
    assert call(*words, "p7", task="gentle_lift") == 0
    assert liked == ["p7"]
    capfd.readouterr()
    assert "scratch have no preferences" in failure(capfd, call(*words, "p7"))
    assert "preferences are p10" in failure(capfd, call(*words, "p10", task="gentle_lift"))
