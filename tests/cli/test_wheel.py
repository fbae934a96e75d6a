"""The wheels, installed in environments of their own, used in another folder with a remote."""

import functools
import http.server
import os
import re
import subprocess
import sys
import threading
import tomllib
import venv
from collections.abc import Callable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution, entry_points
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from assistax_zoo.shell.installed import COMMANDS, ELSEWHERE, INSTALL
from tests.cli.test_docs_commands import printed_commands
from zoo.registry import load_registry

ROOT = Path(__file__).parents[2]
CORE, WORKSHOP, BOARD = "assistax-zoo", "assistax-zoo-workshop", "assistax-zoo-board"
CARE, PAPER = "assistax-zoo-care", "assistax-zoo-paper"
FOLDERS = {CORE: ROOT, WORKSHOP: ROOT / "workshop", BOARD: ROOT / "board"}
FOLDERS |= {CARE: ROOT / "packages" / "care", PAPER: ROOT / "packages" / "paper"}
MOST_BYTES = 100 * 10**6  # that PyPI takes in a file
# flax names them too, whose `linen` does without.
TRAINING = {"optax", "orbax-checkpoint", "tensorstore"}
TEAM = "scratch/ippo-d1-s0-v1"
PARTNERS = "scratch/ippo-d1-s[01]-v1/human"
PLAY = ("--task", "scratch", "--episodes", "1", "--backend", "native")
SCRIPT = f"""
import importlib.util
import sys

import numpy as np
import assistax_zoo as az

assert az.open_zoo().partner({TEAM!r}).act(np.zeros((2, 38), np.float32)).shape == (2, 3)
options = dict(task="scratch", episodes=1, backend="native", progress=False)
result = az.evaluate(lambda obs: np.zeros((len(obs), 7)), split="both", partners={PARTNERS!r},
                     references=False, **options)
assert result.episodes.height == 2
result.report("mine.html")
az.cross_play("{TEAM}/robot", "{TEAM}/human", **options).plot("xp.png")
absent = ("optax", "orbax", "onnx", "sqlalchemy", "fastapi", "assistax_board", "assistax_workshop")
print(az.__file__, [name for name in absent if importlib.util.find_spec(name)])
"""


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the wheels of all distributions."""
    folder = tmp_path_factory.mktemp("wheels")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--quiet"]
    options = ["--no-deps", "--no-index", "--no-build-isolation", "--wheel-dir", str(folder)]
    places = map(str, FOLDERS.values())
    subprocess.run([*pip, *options, *places], check=True, timeout=300)
    return folder


@pytest.fixture(scope="module")
def core(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_environment(tmp_path_factory.mktemp("core"), wheels, CORE, without=TRAINING)


@pytest.fixture(scope="module")
def whole(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_environment(tmp_path_factory.mktemp("whole"), wheels, CORE, WORKSHOP, BOARD)


@pytest.fixture(scope="module")
def remote() -> Iterator[str]:
    """Serve the checkout, which has the layout of a remote."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(ROOT))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def call(tmp_path: Path) -> Callable[..., str]:
    """Return a function that runs a program of an environment and returns what it prints."""
    ours = ("PYTHONPATH", "ASSISTAX_", "XDG_", "XLA_", "JAX_")  # XLA's flags change last bits
    clean = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    clean |= {"HOME": str(tmp_path / "home"), "JAX_PLATFORMS": "cpu"}
    (tmp_path / "work").mkdir()

    def call(program: Path, *words: str, code: int = 0) -> str:
        done = subprocess.run(
            [str(program), *words], cwd=tmp_path / "work", env=clean,
            capture_output=True, text=True, timeout=600,
        )  # fmt: skip
        assert done.returncode == code, done.stderr
        return done.stderr if code else done.stdout

    return call


def test_commands_that_may_be_missing_are_those_of_the_entry_points() -> None:
    brought = {
        name: {tuple(point.name.split(".")) for point in entry_points(group=COMMANDS)
               if point.dist and point.dist.name == name}
        for name in ELSEWHERE
    }  # fmt: skip
    for name, commands in ELSEWHERE.items():
        for command in commands:
            assert any(words[: len(command)] == command for words in brought[name]), command
        for words in brought[name]:
            assert any(words[: len(command)] == command for command in commands), words


@pytest.mark.slow
def test_the_core_alone_does_the_three_jobs_with_a_remote(
    core: Path, remote: str, tmp_path: Path, call: Callable[..., str]
) -> None:
    zoo = functools.partial(call, core / "assistax-zoo")
    assert f"{len(load_registry().policies)} policies" in zoo("list")
    evaluate = ("evaluate", *PLAY, f"{TEAM}/robot", "--split", "both")
    evaluate = (*evaluate, "--partners", PARTNERS, "--include-own", "--out", "results")
    message = zoo(*evaluate, code=1)
    assert "parameters of 4 of 4 policies" in message and "--fetch does so" in message
    assert "pip install assistax-zoo-paper" in message
    assert "--from names one" in zoo(*evaluate, "--fetch", code=1)
    assert zoo("config", "remote", remote) == f"{remote}\n"
    assert "M_test" in zoo(*evaluate, "--fetch")
    teams = ("--robots", "scratch/ippo-d1-s[01]-v1", "--humans", PARTNERS)
    assert "cross-play" in zoo("crossplay", *PLAY, *teams, "--out", "xp")
    zoo("plot", "crossplay", "xp", "--out", "xp.pdf")
    zoo("report", "results", "--out", "results.html")
    zoo("show", TEAM, "--card", "card.md")
    place, absent = call(core / "python", "-c", SCRIPT).split(" ", 1)
    assert place.startswith(str(core.parent)) and absent == "[]\n"
    for name in ("xp.pdf", "results.html", "mine.html", "xp.png", "card.md"):
        assert (tmp_path / "work" / name).stat().st_size > 500


@pytest.mark.slow
def test_wheels_fit_a_package_index(wheels: Path) -> None:
    sizes = {path.name: path.stat().st_size for path in wheels.iterdir()}
    assert len(sizes) == len(FOLDERS) and max(sizes.values()) < MOST_BYTES, sizes
    versions = {distribution_version(folder) for folder in FOLDERS.values()}
    assert len(versions) == 1


def distribution_version(folder: Path) -> str:
    return tomllib.loads((folder / "pyproject.toml").read_text())["project"]["version"]


@pytest.mark.slow
def test_data_packages_do_the_three_jobs_without_network(
    wheels: Path, tmp_path_factory: pytest.TempPathFactory, call: Callable[..., str]
) -> None:
    """Partners, M_test and the clustered cross-play, of both tracks, outside the checkout."""
    place = make_environment(tmp_path_factory.mktemp("data"), wheels, CORE, CARE, PAPER)
    zoo = functools.partial(call, place / "assistax-zoo")
    native = ("--backend", "native", "--episodes", "1")
    zoo("export", f"{TEAM}/human", "--format", "safetensors", "--out", "partner.safetensors")
    robot = "gentle_scratch/dagger-ego-s0"
    assert "M_test" in zoo("evaluate", robot, *native, "--persons", "2", "--no-references")
    teams = ("--robots", "scratch/ippo-d1-s[01]", "--humans", "scratch/ippo-d1-s[01]")
    assert "cross-play" in zoo("crossplay", *teams, *native, "--out", "xp")
    zoo("plot", "crossplay", "xp", "--out", "xp.pdf")


@pytest.mark.slow
def test_the_core_names_what_a_command_lacks(core: Path, call: Callable[..., str]) -> None:
    zoo = functools.partial(call, core / "assistax-zoo", code=1)
    for name, commands in ELSEWHERE.items():
        assert f"{INSTALL[name]}\n" in zoo(*commands[-1], "--help")
    assert "pip install 'assistax-zoo[train]'" in zoo("train", "--task", "scratch", "--out", "run")
    text = "import assistax_zoo as az; az.audit('scratch', [])"
    assert INSTALL[WORKSHOP] in call(core / "python", "-c", text, code=1)


@pytest.mark.slow
def test_readme_and_start_run_in_the_core_alone(
    core: Path, tmp_path: Path, call: Callable[..., str]
) -> None:
    """As they are printed, with the partners of a clone; a film of 50 steps says as much."""
    env, clone = Path("/usr/bin/env"), f"ASSISTAX_ZOO_REGISTRY={ROOT / 'registry.json'}"
    start = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    robot, example = re.findall(r"```python\n(.*?)```", start, re.DOTALL)
    (tmp_path / "work" / "my_robot.py").write_text(robot)
    printed = list(printed_commands((ROOT / "README.md").read_text(encoding="utf-8") + start))
    assert len(printed) >= 9
    done = []
    for words in printed:
        if words not in done:  # README's are start's first
            more = ("--steps", "50") if words[0] == "watch" else ()
            call(env, clone, str(core / "assistax-zoo"), *words, *more)
            done.append(words)
    answers = call(env, clone, str(core / "python"), "-c", example)
    # As the page prints it, but for what last bits do: XLA's code differs among processors. Two
    # kinds gave 310.7 and 310.2, beside an interval of 45.
    [shown] = re.findall(r"^M_test (-?[\d.]+) ", start, re.MULTILINE)
    [found] = re.findall(r"^Estimate\(mean=(-?[\d.]+),", answers)
    assert float(found) == pytest.approx(float(shown), rel=0.01)
    for name in ("ego.html", "mine.html", "watch.html", "crossplay.png"):
        assert (tmp_path / "work" / name).stat().st_size > 500


@pytest.mark.slow
def test_workshop_and_board_beside_the_core_add_their_commands(
    whole: Path, call: Callable[..., str]
) -> None:
    zoo = functools.partial(call, whole / "assistax-zoo")
    assert "serve" in zoo("--help")
    for commands in ELSEWHERE.values():
        for command in commands:
            assert f"assistax-zoo {' '.join(command)}" in zoo(*command, "--help")


def make_environment(
    folder: Path, wheels: Path, *names: str, without: set[str] | frozenset[str] = frozenset()
) -> Path:
    """Return the programs of an environment: wheels, and what they need of what runs here."""
    venv.create(folder / "venv")
    [packages] = (folder / "venv/lib").glob("python*/site-packages")
    code = tuple(name for name in names if name not in (CARE, PAPER))  # data needs the core alone
    for installed in needed(code, {*FOLDERS, *without}).values():
        for top in {file.parts[0] for file in installed.files or ()} - {"..", "__pycache__"}:
            if not (packages / top).exists():
                (packages / top).symlink_to(Path(str(installed.locate_file(top))).resolve())
    files = [str(next(wheels.glob(f"{name.replace('-', '_')}-[0-9]*.whl"))) for name in names]
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    python = str(folder / "venv/bin/python")
    options = ("--no-deps", "--no-index")
    subprocess.run([*pip, "--python", python, "install", *options, *files], check=True)
    return folder / "venv/bin"


def needed(names: tuple[str, ...], without: set[str]) -> dict[str, Distribution]:
    """Return the distributions that some of ours need, and what those need in turn."""
    chosen: dict[str, Distribution] = {}
    seen: set[tuple[str, str]] = set()
    waiting = [(name, "") for name in names]
    while waiting:
        name, extra = waiting.pop()
        if (name, extra) in seen or name in without - FOLDERS.keys():
            continue
        seen.add((name, extra))
        try:
            installed = distribution(name)
        except PackageNotFoundError:
            continue  # for another Python or system
        if name not in without:
            chosen[name] = installed
        for text in installed.requires or ():
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
                waiting += [(requirement.name, part) for part in ("", *requirement.extras)]
    return chosen
