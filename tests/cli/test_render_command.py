"""`assistax-zoo render`: films and strips of an episode, or one clear line why not."""

import itertools
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image

from assistax_zoo.shell.main import run
from evaluation import film
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from zoo.parameters.storage import write_policy_file

ROBOT = PolicySpec("robot", observation_size=34, action_size=7, hidden=(8,))
SMALL = ("--width", "160", "--height", "120")


def call(
    *words: object, robot: object = "random", human: object = "zero", task: str = "scratch"
) -> int:
    return run(
        ["render", "--task", task, "--robot", str(robot), "--human", str(human), *map(str, words)]
    )


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
    path = tmp_path / "robot.safetensors"
    params = jax.tree.map(
        lambda leaf: np.array(leaf), jax.jit(Policy(ROBOT).init)(jax.random.key(0))
    )
    write_policy_file(path, ROBOT, params)
    out = tmp_path / f"film.{ending}"
    assert (
        call("--out", out, "--steps", 20, "--fps", 10, "--camera", "close", *SMALL, robot=path) == 0
    )
    with Image.open(out) as film:
        film.load()  # a .webp tells a frame's time with the frame
        assert (getattr(film, "n_frames", 1), film.info["duration"], film.size) == (
            5,
            100,
            (160, 120),
        )


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
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-i",
        out,
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
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
        (
            ("--out", "x.avi"),
            "x.avi ends in '.avi'; pictures are written as .mp4, .gif, .webp, .png",
        ),
        (("--out", "x"), "x ends in 'nothing'"),
        (("--out", "x.gif", "--fps", 30), "fps is 30; allowed are 1, 2, 5, 10, 25, 50"),
        (("--out", "x.png", "--steps", 0), "steps is 0; allowed are 1 to 1000"),
        (("--out", "x.png", "--steps", 1001), "steps is 1001; allowed are 1 to 1000"),
        (("--out", "x.png", "--camera", "up"), "camera is 'up'; allowed are"),
        (("--out", "x.png", "--width", 3), "width is 3; allowed are 16 to 4096"),
        (("--out", "x.png", "--disability", "d10"), "disability setting is 'd10'; allowed are d1"),
    ],
)
def test_wrong_values_get_one_line(words: tuple, message: str, tmp_path: Path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in failure(capfd, call(*words))
    assert list(tmp_path.iterdir()) == []


def test_unknown_policies_and_tasks_get_one_line(tmp_path: Path, capfd):
    out = ("--out", tmp_path / "x.png")
    assert "policy 'best' has an unknown form; allowed are an id such as" in failure(
        capfd, call(*out, robot="best")
    )
    assert "unknown policy 'scratch/ippo-d1-s0-v99'" in failure(
        capfd, call(*out, human="zoo:scratch/ippo-d1-s0-v99")
    )
    assert "task is 'swim'; allowed are scratch" in failure(capfd, call(*out, task="swim"))


def test_unwritable_place_is_refused_before_work(tmp_path: Path, capfd, monkeypatch):
    monkeypatch.setattr("assistax_envs.make", lambda *_: pytest.fail("work was done"))
    (tmp_path / "file").touch()
    assert "x.png cannot be written" in failure(capfd, call("--out", tmp_path / "file" / "x.png"))
    (tmp_path / "folder.gif").mkdir()
    assert "folder.gif cannot be written (it is a folder)" in failure(
        capfd, call("--out", tmp_path / "folder.gif")
    )


def test_an_mp4_without_its_package_names_the_extra(tmp_path: Path, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert "pip install 'assistax-zoo[video]', or write .gif" in failure(
        capfd, call("--out", tmp_path / "x.mp4")
    )


def test_an_mp4_of_odd_size_is_refused(tmp_path: Path, capfd):
    assert "the size is 161x120; an .mp4 needs an even width" in failure(
        capfd, call("--out", tmp_path / "x.mp4", "--width", 161, "--height", 120)
    )
    assert os.listdir(tmp_path) == []


def test_a_machine_without_opengl_gets_one_line(tmp_path: Path, capfd, monkeypatch):
    from assistax_envs.drawing import gl

    def broken(width: int, height: int):
        raise gl.RenderError(f"this machine cannot draw; apt-get install {gl.PACKAGES}")

    monkeypatch.setattr("assistax_envs.drawing.render.open_context", broken)
    assert "apt-get install libegl1" in failure(
        capfd, call("--out", tmp_path / "x.png", "--steps", 2)
    )
    assert os.listdir(tmp_path) == []


def test_an_episode_needs_both_players(tmp_path: Path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["render", "--task", "scratch", "--robot", "zero", "--out", "x.png"]) == 2
    assert "--human" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


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
