"""Files of robots from outside must not change, and varying answers are noted."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.cast.egos import EgoError, read_egos
from evaluation.cast.roster import HostEgo, Member, Roster
from evaluation.figures.summary import read_summary
from evaluation.play.evaluator import PARTS_FOLDER, run_job
from evaluation.play.how import PlaySettings
from evaluation.play.jobs import Job
from evaluation.play.robot_checks import NOTES, check_distinct, robot_notes, varying
from evaluation.record.manifest import read_manifest
from evaluation.record.verification import check_sources, verify_folder
from evaluation.replay.replay import replay_folder
from population.networks.onnx_export import to_onnx
from tests.attack.commands import small_zoo
from tests.evaluation.matrix_game import ROBOT, MatrixGame, humans
from tests.evaluation.test_sources import toy
from tests.studies import evaluate_policies
from tests.untrained import params_of
from zoo.parameters.storage import load_stacks, write_policy_file
from zoo.registry import Registry, load_registry

EMPTY: Any = Registry(data=None, path=Path("registry.json"), policies=[])  # type: ignore[arg-type]
LAZY = """
import numpy as np
DEPENDS = []
def make():
    def act(obs):
        import helper
        return np.full((len(obs), %d), helper.GAIN)
    return act
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def play(robot: str, out: Path, **options: Any) -> list[float]:
    """Play a robot in the matrix game, two chunks, and return its returns."""
    egos = read_egos([robot], EMPTY, "scratch")
    job = Job("matrix", 1, "mjx", egos, humans(-0.5, 0.5), episodes=2)
    return run_job(MatrixGame(), job, out, max_envs=2, **options).table["return"].to_list()


@pytest.mark.slow
def test_changed_late_helper_is_not_reused(folder: Path) -> None:
    (folder / "mine.py").write_text(LAZY % 2)
    (folder / "helper.py").write_text("GAIN = -0.5\n")
    first = play("python:mine.py:make", folder / "out")
    assert play("python:mine.py:make", folder / "out") == first
    (folder / "helper.py").write_text("GAIN = 0.5\n")
    with pytest.raises(ValueError, match=r"loaded .*helper.py while it played, and that file is"):
        play("python:mine.py:make", folder / "out")
    assert play("python:mine.py:make", folder / "out", reuse=True) == first
    assert play("python:mine.py:make", folder / "new") != first


def test_a_declared_helper_is_of_the_digest(folder: Path) -> None:
    (folder / "sub").mkdir()
    code = (LAZY % 2).replace("DEPENDS = []", "DEPENDS = ['sub/../helper.py']")
    (folder / "mine.py").write_text(code)
    (folder / "helper.py").write_text("GAIN = -0.5\n")
    play("python:mine.py:make", folder / "out")
    assert "robots" not in (read_manifest(folder / "out") or {})
    (folder / "helper.py").write_text("GAIN = 0.5\n")
    with pytest.raises(ValueError, match="holds another job"):
        play("python:mine.py:make", folder / "out")


def test_parts_of_changed_helper_stay_apart(folder: Path) -> None:
    (folder / "mine.py").write_text(LAZY % 2)
    (folder / "helper.py").write_text("GAIN = -0.5\n")

    def stop(progress: Any) -> None:
        if any((folder / "out" / PARTS_FOLDER).glob("part-*")):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        play("python:mine.py:make", folder / "out", on_progress=stop)
    (folder / "helper.py").write_text("GAIN = 0.5\n")
    with pytest.raises(ValueError, match=r"loaded .*helper.py while it played"):
        play("python:mine.py:make", folder / "out")


CHANGING = """
import pathlib
import numpy as np
import helper
DEPENDS = ["weights.txt"]
calls = []
def make():
    def act(obs):
        calls.append(0)
        if len(calls) == 6:  # in the second chunk
            pathlib.Path(%r).write_text("GAIN = 0.5")
        return np.full((len(obs), 2), helper.GAIN)
    return act
"""


@pytest.mark.parametrize("name", ["mine.py", "helper.py", "weights.txt"])
def test_a_file_that_changes_during_play_is_named(folder: Path, name: str) -> None:
    (folder / "mine.py").write_text(CHANGING % str(folder / name))
    (folder / "helper.py").write_text("GAIN = -0.5\n")
    (folder / "weights.txt").write_text("1\n")
    whole = (folder / name).read_bytes()
    with pytest.raises(EgoError, match=rf"{name}, a file of python:mine.py:make, changed while"):
        play("python:mine.py:make", folder / "out")
    assert "files" not in (read_manifest(folder / "out") or {})  # nothing is sealed
    [part] = (folder / "out" / PARTS_FOLDER).glob("part-*")
    (folder / name).write_bytes(whole)
    assert play("python:mine.py:make", folder / "out") and not part.exists()  # it goes on


def test_policy_file_changed_during_play_is_named(folder: Path) -> None:
    path = folder / "own.safetensors"
    write_policy_file(path, ROBOT, params_of(ROBOT, 7))

    def change(progress: Any) -> None:
        write_policy_file(path, ROBOT, params_of(ROBOT, 8))

    with pytest.raises(EgoError, match=r"own.safetensors, a file of .*, changed while the robot"):
        play(str(path), folder / "out", on_progress=change)
    assert "files" not in (read_manifest(folder / "out") or {})


def test_hashed_code_is_code_that_ran(folder: Path) -> None:
    """The module changes its helper before it imports it, and back."""
    (folder / "helper.py").write_text("GAIN = 1\n")
    (folder / "mine.py").write_text(
        "import pathlib\n"
        "path = pathlib.Path('helper.py')\n"
        "path.write_text('GAIN = 22')\n"
        "import helper\n"
        "path.write_text('GAIN = 1')\n"
        "DEPENDS = []\n"
        "make = lambda: lambda obs: obs[:, :2]\n"
    )
    with pytest.raises(EgoError, match=r"helper.py, a file of python:mine.py:make, changed"):
        play("python:mine.py:make", folder / "out")


def recurrent() -> Any:
    class Remembering:
        def reset(self, rows: int) -> None:
            self.seen = np.zeros((rows, 2))

        def act(self, obs: np.ndarray) -> np.ndarray:
            self.seen += obs[:, :2]
            return self.seen

    return Remembering()


def counting() -> Callable[[np.ndarray], np.ndarray]:
    calls: list[int] = []
    return lambda obs: calls.append(0) or np.full((len(obs), 2), float(len(calls)))  # type: ignore[func-returns-value]


def drawing() -> Callable[[np.ndarray], np.ndarray]:
    rng = np.random.default_rng(0)
    return lambda obs: rng.normal(size=(len(obs), 2))


def choosy(obs: np.ndarray) -> np.ndarray:
    assert not obs.any()
    return obs[:, :2]


ROBOTS: dict[str, tuple[Callable[[], Any], str | None]] = {
    "plain": (lambda: lambda obs: np.tanh(obs[:, :2]), None),
    "recurrent": (recurrent, None),
    "rounding": (lambda: lambda obs: obs[:, :2] + 1e-6 * obs.mean(), None),
    "batch mean": (lambda: lambda obs: obs[:, :2] - obs[:, :2].mean(axis=0), "rows"),
    "place": (lambda: lambda obs: obs[:, :2] + np.arange(len(obs))[:, None], "rows"),
    "earlier calls": (counting, "calls"),
    "chance": (lambda: lambda obs: np.random.normal(size=(len(obs), 2)), "calls"),
    "own chance": (drawing, "calls"),
    "choosy": (lambda: choosy, "unknown"),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_varying_answers_are_found(name: str) -> None:
    make, expected = ROBOTS[name]
    egos = Roster((HostEgo("host", make()),), {"host": Member("host", "0")})
    chance = str(np.random.get_state())
    assert varying(egos, 3).get("host") == expected
    assert str(np.random.get_state()) == chance


def test_received_notes_use_own_words() -> None:
    egos = Roster((HostEgo("host", lambda obs: obs),), {"host": Member("host", "0")})
    for about in (None, [], {"varies": 3, "loaded": []}, {"varies": {"host": "<b>", "x": "rows"}}):
        assert robot_notes(about, egos) == []
    [first, second] = robot_notes(
        {"varies": {"host": "rows"}, "loaded": {"host": {"/a/b.py": "0"}}}, egos
    )
    assert first == f"host {NOTES['rows']}" and second.startswith("host loaded b.py only while")


@pytest.mark.slow
def test_told_evaluation_is_noted_and_replayed(
    folder: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("assistax_envs.make", toy)
    (folder / "mine.py").write_text(
        (LAZY % 1).replace("helper.GAIN)", "helper.GAIN) * obs.mean() * 9")
    )
    (folder / "helper.py").write_text("GAIN = 0.5\n")
    how, robot = PlaySettings("scratch", 1, backend="native"), "python:mine.py:make"
    for _ in range(2):  # played, then found
        evaluate_policies(registry, [robot], how, folder / "out")
        notes = read_summary(folder / "out").notes
        assert f"{robot} {NOTES['rows']}" in notes
        assert any(note.startswith(f"{robot} loaded helper.py only while") for note in notes)
        assert not verify_folder(folder / "out").problems
    report = replay_folder(folder / "out", registry, run_code=True)
    assert report.ok and report.exact and not report.unchecked, report
    assert not check_sources(folder / "out", registry.path).problems
    (folder / "helper.py").write_text("GAIN = 0.25\n")
    assert "helper.py" in check_sources(folder / "out", registry.path).problems[0]


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    return load_registry(small_zoo(tmp_path_factory.mktemp("zoo") / "zoo"))


def copies(folder: Path, registry: Registry) -> dict[str, Any]:
    """Return one robot under many names, and a robot of code and one of objects under two."""
    entry = registry.policy("scratch/ippo-d1-s0-v0/robot")
    [stack] = load_stacks(registry, [entry])
    params = stack.row(0)
    write_policy_file(folder / "own.safetensors", entry.spec, params)
    write_policy_file(folder / "claims.safetensors", entry.spec, params, {"told": False})
    (folder / "own.onnx").write_bytes(to_onnx(entry.spec, params, {"id": "another"}))
    (folder / "link.safetensors").symlink_to(folder / "own.safetensors")
    for name in ("mine.py", "copy.py"):
        (folder / name).write_text("make = lambda gain, path='': lambda obs: obs[:, :1]\n")
    (folder / "a.pt").write_bytes(b"0")
    (folder / "b.pt").write_bytes(b"0")

    def act(obs: np.ndarray) -> np.ndarray:
        return obs[:, :1]

    return {
        "id and file": ["zoo:" + entry.id, "own.safetensors"],
        "file and its metadata": ["own.safetensors", "claims.safetensors"],
        "file and link": ["own.safetensors", "link.safetensors"],
        "two paths": ["own.safetensors", str(folder / "own.safetensors")],
        "id and graph": ["own.onnx", "zoo:" + entry.id],
        "two graphs": ["own.onnx", f"onnx:{folder}/own.onnx"],
        "code": ["python:mine.py:make?gain=1", f"python:{folder}/mine.py:make?gain=1"],
        "copied code": ["python:mine.py:make?gain=1", "python:copy.py:make?gain=1"],
        "arguments": [f"python:mine.py:make?gain=1&path={name}.pt" for name in "ab"],
        "object": [act, act],
    }


def test_copies_of_one_robot_are_no_seeds(folder: Path, registry: Registry) -> None:
    for given in copies(folder, registry).values():
        egos = read_egos(given, registry, "scratch")
        with pytest.raises(ValueError, match=r".* and .* are the same robot, .*; give it once"):
            check_distinct(egos)


def test_seeds_of_one_method_are_taken(folder: Path, registry: Registry) -> None:
    entry = registry.policy("scratch/ippo-d1-s0-v0/robot")
    (folder / "other.onnx").write_bytes(to_onnx(entry.spec, params_of(entry.spec, 9)))
    (folder / "mine.py").write_text("make = lambda gain: lambda obs: obs[:, :1]\n")
    code = ["python:mine.py:make?gain=1", "python:mine.py:make?gain=2"]
    others = ["scratch/ippo-d1-s*-v0/robot", "other.onnx", *code, lambda obs: obs, lambda obs: obs]
    check_distinct(read_egos(others, registry, "scratch"))
