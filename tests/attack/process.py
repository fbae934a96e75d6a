"""A command in a process of its own, forked from one that has imported most of it: cheap to kill.

The server that forks has no thread but its own, since no other would survive; so each child starts
JAX, and imports Polars.

Others use this machine too. What a process waited for a processor is no fault of its own, and the
kernel counts it for every thread. `waited` is that of the thread that waited most, less than what
others took. `work` is the time without what all threads waited together, but at least what was
computed: a process that hangs neither waits nor computes.
"""

import _thread
import contextlib
import dataclasses
import json
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["tests.attack.preload"])
COMPILED = Path("~/.cache/assistax-zoo/xla-tests").expanduser()


@dataclasses.dataclass(frozen=True)
class Attack:
    """What happens to a process."""

    kill_at: int | None = None  # the write at which it kills itself
    limits: Mapping[str, int] = dataclasses.field(default_factory=dict)  # RLIMIT_...
    more_files: int | None = None  # that it may open beside those that are open
    more_threads: int | None = None  # that Python may start
    closed: tuple[int, ...] = ()  # descriptors


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How a process ended."""

    code: int | None  # minus the signal's number if one ended it
    out: str
    err: str
    seconds: float  # from its start or the key press to its end
    waited: float  # of them, for a processor
    work: float  # seconds, without waiting for other processes
    computed: float  # seconds of processors, from when it was ready
    peak: int  # bytes of memory
    writes: int
    outside: tuple[str, ...]  # written outside its folder


Press = tuple[int, float]  # a signal, and after how much computing it is sent, in seconds


def call(
    words: Sequence[str],
    home: Path,
    attack: Attack | None = None,
    press: Press | None = None,
    longest: float = 300.0,
) -> Outcome:
    """Run one command whose files all lie in `home`, and return how it ended.

    After the `longest` time in seconds it is killed.
    """
    home.mkdir(parents=True, exist_ok=True)
    ready, pressed = home / "ready", None
    ready.unlink(missing_ok=True)
    child: Any = CONTEXT.Process(target=_child, args=(list(words), str(home), attack or Attack()))
    began = time.monotonic()
    child.start()
    seen = _Seen(child.pid)
    while child.is_alive() and time.monotonic() - began < longest:
        if seen.ready is None and ready.exists():
            seen.ready = seen.computed
        if press and pressed is None and seen.ready is not None and seen.since() >= press[1]:
            pressed = time.monotonic()
            seen.waited_before = seen.waited
            os.kill(child.pid, press[0])
        child.join(0.02)
        seen.look()
    ended = time.monotonic()
    if child.is_alive():
        child.kill()
        child.join()
    counts = home / "writes.json"
    writes = json.loads(counts.read_text()) if counts.is_file() else {}
    return Outcome(
        child.exitcode,
        _told(home / "out.txt"),
        _told(home / "err.txt"),
        ended - (pressed or began),
        seen.waited - seen.waited_before,
        max(seen.computed, ended - began - seen.waited_in_all),
        seen.since(),
        seen.peak,
        writes.get("count", 0),
        tuple(writes.get("outside", ())),
    )


class _Seen:
    """What the kernel tells of a process while it runs: its memory, its work and its waiting."""

    def __init__(self, pid: int) -> None:
        self.folder = Path(f"/proc/{pid}")
        self.peak, self.computed = 0, 0.0
        self.waited, self.waited_before, self.waited_in_all = 0.0, 0.0, 0.0
        self.ready: float | None = None  # what it had computed by then

    def look(self) -> None:
        with contextlib.suppress(OSError, StopIteration, ValueError):  # it is ending
            lines = (self.folder / "status").read_text().splitlines()
            peak = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
            self.peak = max(self.peak, peak * 1024)
            ticks = (self.folder / "stat").read_text().rpartition(")")[2].split()[11:13]
            self.computed = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
            waits = waited(self.folder)
            self.waited = max(self.waited, *waits)
            self.waited_in_all = max(self.waited_in_all, sum(waits))

    def since(self) -> float:
        return self.computed - (self.ready or 0.0)


def waited(process: Path) -> list[float]:
    """Return how many seconds each thread of a process waited for a processor."""
    statistics = [path.read_text().split() for path in process.glob("task/*/schedstat")]
    return [int(words[1]) / 1e9 for words in statistics]


def _child(words: list[str], home: str, attack: Attack) -> None:
    from assistax_zoo.shell import main
    from tests.attack.watch import Watch

    os.chdir(home)
    _redirect(Path(home))
    _environment(home)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if words[0] != "render":
        _play_a_toy()
    (Path(home) / "ready").touch()
    watch = Watch([Path(home), COMPILED], attack.kill_at)
    _strain(attack)
    sys.argv = ["assistax-zoo", *words]
    try:
        code = main.run()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    watch.on = False
    _end(watch, Path(home), code)


def _strain(attack: Attack) -> None:
    """Take from this process what the attack takes."""
    for descriptor in attack.closed:
        (sys.stdin, sys.stdout, sys.stderr)[descriptor].close()
        with contextlib.suppress(OSError):
            os.close(descriptor)
    if attack.closed == (1,):
        sys.stdout = None  # as the interpreter starts without it
    limits = dict(attack.limits)
    if attack.more_files is not None:
        limits["RLIMIT_NOFILE"] = len(os.listdir("/proc/self/fd")) - 1 + attack.more_files
    for name, value in limits.items():
        resource.setrlimit(getattr(resource, name), (value, value))
    if attack.more_threads is not None:
        threading._start_new_thread = _few(attack.more_threads)  # ty: ignore[missing-attribute]


def _few(count: int) -> Callable[..., int]:
    """Start so many threads; the kernel's own bound does not hold for root."""
    left = iter(range(count))

    def start(*arguments: Any, **options: Any) -> int:
        if next(left, None) is None:
            raise RuntimeError("can't start new thread")
        return _thread.start_new_thread(*arguments, **options)

    return start


def _play_a_toy() -> None:
    """Put an environment in place of the tasks whose physics would take minutes to compile."""
    import assistax_envs
    from evaluation.play import baselines
    from tests.population.toy_env import ToyEnv, match

    baselines.SCRIPTS = {}  # they read the observations of the true tasks

    def make(task: str, backend: str = "native", **_: Any) -> ToyEnv:
        toy = ToyEnv(match)
        toy.task, toy.backend = task, "native"
        return toy

    assistax_envs.make = make  # ty: ignore[invalid-assignment]


def _end(watch: Any, home: Path, code: int) -> None:
    """Leave without the interpreter's shutdown, which would take longer than the command."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            code = code or 1
    seen = {"count": watch.count, "outside": watch.outside}
    with contextlib.suppress(OSError):  # on a full disk this trial's writes are not known
        (home / "writes.json").write_text(json.dumps(seen))
    os._exit(code)


def _redirect(home: Path) -> None:
    for descriptor, name in ((1, "out.txt"), (2, "err.txt")):
        file = os.open(home / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, descriptor)
        os.close(file)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", closefd=False, buffering=1)


def _environment(home: str) -> None:
    os.environ |= {
        "HOME": home,
        "XDG_CACHE_HOME": f"{home}/cache",
        "ASSISTAX_ZOO_CACHE": f"{home}/cache/zoo",
        "TMPDIR": home,
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(COMPILED),
        # Its threads have idle priority: on a busy machine a process waits seconds for their end.
        "MESA_SHADER_CACHE_DISABLE": "true",
    }


def _told(path: Path) -> str:
    """Return what the process wrote; one that was killed at once wrote nothing."""
    return path.read_text(errors="replace") if path.is_file() else ""
