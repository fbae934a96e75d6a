"""Robots of Python modules: their own modules, their own files, and nothing they do ends a run."""

import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from evaluation.cast.egos import EgoError, call_ego, read_egos
from evaluation.cast.policy_process import PolicyProcess
from evaluation.cast.roster import HostEgo
from zoo.registry import Registry

EMPTY = Registry(data=cast(Any, None), path=Path("registry.json"), policies=[])
OBS = np.ones((4, 3), np.float32)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path: Path, text: str) -> None:
    path.write_text(textwrap.dedent(text))


def read(reference: str) -> HostEgo:
    (ego,) = read_egos([reference], EMPTY, "scratch").stacks
    assert isinstance(ego, HostEgo)
    return ego


def ask(ego: HostEgo) -> np.ndarray:
    return call_ego(ego, ["t/a-d1-s0-v0/human"], episodes=4, action_size=3)(OBS, 0)


def test_robot_modules_have_own_names(folder: Path) -> None:
    write(folder / "evaluation.py", "GAIN = 2.0")
    write(folder / "zoo.py", "import evaluation\nGAIN = evaluation.GAIN + 1.0")
    write(folder / "mine.py", "import zoo\ndef make():\n    return lambda obs: zoo.GAIN * obs")
    for reference in ("python:mine:make", "python:mine.py:make", f"python:{folder}/mine.py:make"):
        np.testing.assert_array_equal(ask(read(reference)), 3.0 * OBS)
    import zoo

    assert not hasattr(zoo, "GAIN")


def test_a_package_and_arguments(folder: Path) -> None:
    (folder / "pkg").mkdir()
    write(folder / "pkg" / "__init__.py", "")
    write(folder / "pkg" / "parts.py", "def scale(gain): return lambda obs: float(gain) * obs")
    write(folder / "pkg" / "robot.py", "from .parts import scale\nmake = lambda gain: scale(gain)")
    np.testing.assert_array_equal(ask(read("python:pkg.robot:make?gain=4")), 4.0 * OBS)


def digest(reference: str) -> tuple[str, bool]:
    [member] = read_egos([reference], EMPTY, "scratch").members.values()
    return member.digest, member.reusable


def test_digest_covers_code_arguments_and_files(folder: Path) -> None:
    write(folder / "parts.py", "GAIN = 1")
    code = "import parts\n{}\ndef make(weights='a.pt'): return lambda obs: obs"
    write(folder / "mine.py", code.format('DEPENDS = ["b.pt"]'))
    for name in ("a.pt", "b.pt", "c.pt"):
        (folder / name).write_bytes(b"0")
    reference = "python:mine.py:make?weights=a.pt"
    seen = [digest(reference)]
    assert digest(reference) == seen[0] and seen[0][1]
    (folder / "c.pt").write_bytes(b"1")  # nothing to do with it
    assert digest(reference) == seen[0]
    for change in (
        lambda: (folder / "a.pt").write_bytes(b"1"),
        lambda: (folder / "b.pt").write_bytes(b"1"),
        lambda: write(folder / "parts.py", "GAIN = 3"),
        lambda: write(folder / "mine.py", code.format('DEPENDS = ["b.pt"] # new')),
    ):
        change()
        seen.append(digest(reference))
    seen.append(digest("python:mine.py:make?weights=c.pt"))
    assert len(set(seen)) == len(seen)


def test_undeclared_robot_is_not_reusable(folder: Path) -> None:
    (folder / "a.pt").write_bytes(b"0")
    make = "import pathlib\ndef make(): return lambda obs: obs\n"
    for depends, reusable in (
        ("", False),
        ("DEPENDS = []", True),
        ("DEPENDS = (pathlib.Path('a.pt'),)", True),
    ):
        write(folder / "mine.py", make + depends)
        assert digest("python:mine.py:make")[1] is reusable
    write(folder / "mine.py", make + "DEPENDS = ['gone.pt']")
    with pytest.raises(EgoError, match=r"gone\.pt"):
        digest("python:mine.py:make")


@pytest.mark.parametrize(
    ("depends", "message"),
    [
        ("['/dev/zero']", "DEPENDS names /dev/zero, which is no regular file"),
        ("['.']", "DEPENDS names .*, which is no regular file"),
        ("'weights.pt'", "DEPENDS of mine.py is 'weights.pt'; expected a list of paths"),
        ("3", "DEPENDS of mine.py is 3; expected a list of paths"),
    ],
)
def test_depends_must_list_regular_files(folder: Path, depends: str, message: str) -> None:
    write(folder / "mine.py", f"DEPENDS = {depends}\ndef make(): return lambda obs: obs")
    with pytest.raises(EgoError, match=message):
        digest("python:mine.py:make")


@pytest.mark.parametrize(
    ("message", "error"),
    [
        (rb'{"error": "\u001b[31mred\u001b[0m\nline"}', r"step 0: \[31mred \[0m line"),
        *(
            (text, "step 0: the robot's process answers in no form")
            for text in (b"{]", b"[]", b"{}")
        ),
    ],
)
def test_malformed_reply_is_one_line(folder: Path, message: bytes, error: str) -> None:
    """A robot may write to the pipe itself."""
    code = f"""\
        import os, struct
        def act(obs):
            for number in range(3, 10):  # the pipe is one of these
                try:
                    os.write(number, struct.pack("<IQ", {len(message)}, 0) + {message!r})
                except OSError:
                    pass
            return obs
        def make(): return act
        """
    write(folder / "mine.py", code)
    with pytest.raises(EgoError, match=error) as caught:
        ask(read("python:mine.py:make"))
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("sys.exit(0)", "SystemExit: 0"),
        ("raise GeneratorExit", "GeneratorExit"),
        ("raise KeyboardInterrupt", "KeyboardInterrupt"),
        ("os._exit(0)", "the robot's process ended by itself, with code 0"),
        (r"raise ValueError('\x1b[31mred\nline')", r"ValueError: \[31mred line \(mine.py:4\)"),
        ("return np.array(['a'])", "TypeError: returned <U1 of shape"),
        ("return obs[:, :2]", r"returned float32 of shape \(4, 2\)"),
    ],
)
def test_every_failure_is_one_line(folder: Path, line: str, message: str) -> None:
    code = f"import os, sys\nimport numpy as np\ndef act(obs):\n    {line}\nmake = lambda: act"
    write(folder / "mine.py", code)
    with pytest.raises(EgoError, match=f"step 0: {message}") as caught:
        ask(read("python:mine.py:make"))
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("error", [SystemExit(0), GeneratorExit()])
def test_in_process_robot_does_not_end_run(error: BaseException) -> None:
    def act(obs: np.ndarray) -> np.ndarray:
        raise error

    with pytest.raises(EgoError, match=f"step 0: {type(error).__name__}"):
        ask(HostEgo("m", act))


def test_printed_text_is_no_answer(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    code = "print('hello')\ndef act(obs):\n    print('act', flush=True)\n    return obs\n"
    write(folder / "mine.py", code + "make = lambda: act")
    np.testing.assert_array_equal(ask(read("python:mine.py:make")), OBS)
    printed = capfd.readouterr()
    assert printed.out == "" and "act" in printed.err


def test_libraries_use_one_thread(folder: Path) -> None:
    code = "import os\nmake = lambda: lambda obs: obs * float(os.environ['OMP_NUM_THREADS'])"
    write(folder / "mine.py", code)
    np.testing.assert_array_equal(ask(read("python:mine.py:make")), OBS)


def gone(pid: int) -> bool:
    for _ in range(600):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.slow_for("time.sleep")
@pytest.mark.parametrize("line", ["time.sleep(100)", "os.kill(os.getpid(), signal.SIGSTOP)"])
def test_process_ends_with_robot_and_parent(folder: Path, line: str) -> None:
    code = f"import os, signal, time\nmake = lambda: lambda obs: {line}"
    write(folder / "mine.py", code)
    robot = PolicyProcess("mine.py", "make", {})
    # Only this test needs the number of the process.
    pid = robot._process.pid
    robot.close()
    assert gone(pid)
    script = (
        "import os, threading, numpy as np\n"
        "from evaluation.cast.policy_process import PolicyProcess\n"
        "robot = PolicyProcess('mine.py', 'make', {})\n"
        "print(robot._process.pid, flush=True)\n"
        "threading.Timer(0.5, lambda: os._exit(0)).start()\n"
        "robot(np.ones((1, 1), np.float32))\n"
    )
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    assert gone(int(subprocess.check_output([sys.executable, "-c", script], env=env, timeout=60)))


def test_module_without_file_is_accepted(folder: Path) -> None:
    """As PyTorch has: `torch.classes` says that it is in "_classes.py"."""
    code = "import sys, types\nsys.modules['classes'] = types.ModuleType('classes')\n"
    code += "sys.modules['classes'].__file__ = '_classes.py'\nmake = lambda: lambda obs: obs"
    write(folder / "mine.py", code)
    assert digest("python:mine.py:make")[0]
