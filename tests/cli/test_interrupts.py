"""Ctrl-C: a command ends with one line and code 130, a function raises, and Python lives on."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from assistax_zoo.shell.interrupts import CONTINUED

ROOT = Path(__file__).parents[2]
TEAM = "zoo:scratch/ippo-d1-s0-v1"
COMMANDS = {
    "evaluate": f"{TEAM}/robot --backend native --episodes 200 --no-references",
    "crossplay": "--episodes 8 --backend native",
    "train": "--steps 2M --num-envs 64 --backend native",
    "render": f"--robot random --human {TEAM}/human",
}
# From the key press to the end of the process: what two cores compute in two seconds, since a
# machine may be busy with other things, and how long it may take on such a machine.
SOON, AT_LAST = 4.0, 30.0


# As from a terminal: a shell's background jobs ignore the signal.
COMMAND = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from assistax_zoo.__main__ import start
print("begun", flush=True)
sys.exit(start())
"""


def begin(words: list[str], folder: Path) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *words],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "XDG_CACHE_HOME": str(folder / "cache")},
    )


def computed_by(pid: int) -> float:
    """Return the seconds that a process has computed for so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def computed_by_children() -> float:
    """Return the seconds that all processes which this one started and saw end computed for."""
    spent = os.times()
    return spent.children_user + spent.children_system


def last_line(command: str) -> str:
    """Return what a command with --out says at the end."""
    kept = "; what is done is kept, and the same command continues"
    return f"error: interrupted{kept if command in CONTINUED else ''}"


def interrupt(command: str, seconds: float, folder: Path) -> None:
    name = "film.gif" if command == "render" else "out"
    words = [command, "--task", "scratch", *COMMANDS[command].split(), "--out"]
    with begin([*words, str(folder / name)], folder) as process:
        assert process.stdout is not None and process.stdout.readline() == "begun\n"
        others = computed_by_children()
        time.sleep(seconds)
        assert process.poll() is None, f"{command} was done before the key press"
        before = computed_by(process.pid)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=AT_LAST)
    spent = computed_by_children() - others - before
    assert (process.returncode, out) == (130, ""), err
    assert err.splitlines()[-1] == last_line(command)
    assert err.count("error") == 1 and "Traceback" not in err
    assert spent < SOON


@pytest.mark.slow_for("evaluate")
@pytest.mark.parametrize("command", ["evaluate", "train"])
def test_a_command_ends_soon_with_one_line(command: str, tmp_path: Path) -> None:
    interrupt(command, random.Random(command).uniform(1.5, 5.0), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("trial", range(8 if os.environ.get("ASSISTAX_ATTACK") else 3))
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_ends_soon_at_any_moment(command: str, trial: int, tmp_path: Path) -> None:
    interrupt(command, random.Random(f"{command} {trial}").uniform(1.0, 12.0), tmp_path)


FUNCTION = """
import os, signal, sys, threading, time
import jax
from pathlib import Path
from evaluation.play.how import PlaySettings
from tests.studies import evaluate_policies
from zoo.registry import load_registry

folder = Path(sys.argv[1])

def press():
    os.kill(os.getpid(), signal.SIGINT)

def evaluate(episodes, on_progress=None):
    settings = PlaySettings("scratch", episodes, backend="native")
    return evaluate_policies(load_registry(), ["zoo:scratch/ippo-d1-s0-v1/robot"], settings,
        folder / str(episodes), partners="scratch/ippo-d1-s[0-3]-v1/human", on_progress=on_progress)

for seconds in map(float, sys.argv[2:]):
    timers = []
    def begin(state):
        if not timers:
            timers.append(threading.Timer(seconds, press))
            timers[0].start()
    try:
        evaluate(400, begin)
        print("swallowed")
    except KeyboardInterrupt:
        print("interrupted")
left = [thread for thread in threading.enumerate() if "interruptible" in thread.name]
print(jax.numpy.arange(3).sum(), len(left))
"""


@pytest.mark.slow
def test_a_function_raises_and_leaves_the_interpreter_alive(tmp_path: Path) -> None:
    rng = random.Random(0)
    moments = [str(rng.uniform(0.1, 4.0)) for _ in range(2)]
    done = subprocess.run(
        [sys.executable, "-c", FUNCTION, str(tmp_path), *moments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "interrupted\n" * 2 + "3 0\n"


TERMINAL = """
import atexit, enum, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it

def press():
    os.kill(os.getpid(), signal.SIGINT)
"""


def interrupted_with_one_line(program: str, *arguments: str) -> None:
    words = [sys.executable, "-c", TERMINAL + program, *arguments]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "error: interrupted\n")


def test_ctrl_c_while_jax_is_loaded_is_one_line() -> None:
    """Its C++ makes an enumeration in Python, and would abort at an exception from there."""
    interrupted_with_one_line("""
from assistax_zoo.shell.interrupts import ended_by_interrupts

def profile(frame, event, argument):
    caller = frame.f_back and frame.f_back.f_code.co_name
    if frame.f_code.co_filename == enum.__file__ and caller == "_call_with_frames_removed":
        sys.setprofile(None)
        press()

with ended_by_interrupts():
    sys.setprofile(profile)
    import jax
""")


LAST_MOMENTS = {
    "lost in a destructor": """
class Lost:
    def __del__(self):
        press()
work = lambda: Lost() and None
""",
    "on the way out": "main.ended_by_interrupts = leaving; work = lambda: None",
    "at exit": "work = lambda: atexit.register(press)",
    "at exit, twice": "work = lambda: atexit.register(lambda: (press(), press()))",
    "at exit after a refusal": "work = lambda: (atexit.register(press), sys.exit(1))",
}


@pytest.mark.parametrize("moment", LAST_MOMENTS)
def test_ctrl_c_in_the_last_moments_is_one_line(moment: str) -> None:
    """The work is done, the answer printed, and the interpreter on its way out."""
    program = """
from assistax_zoo.shell import main

ended = main.ended_by_interrupts

class leaving:
    def __enter__(self):
        self.inner = ended()
        self.inner.__enter__()
    def __exit__(self, *error):
        press()
        return self.inner.__exit__(*error)

{moment}
main.build_app = lambda **left: type("App", (), {{"__call__": lambda *words, **given: work()}})()
main._complete_help = lambda *given: None
sys.exit(main.run())
"""
    interrupted_with_one_line(program.format(moment=LAST_MOMENTS[moment]))


def test_ctrl_c_during_import_is_one_line() -> None:
    program = """
class Press:
    def find_spec(self, name, path=None, target=None):
        if name == "assistax_zoo.shell.main":
            press()

sys.meta_path.insert(0, Press())
from assistax_zoo.__main__ import start
sys.exit(start())
"""
    interrupted_with_one_line(program, "list")
