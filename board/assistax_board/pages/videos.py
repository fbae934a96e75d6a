"""Films of public pairs, made when somebody asks and kept for everybody after.

A film and the returns of its pair are made by the command line in a process of their own, one pair
at a time: whatever goes wrong there, or takes too long, the pages stay up.
"""

import contextlib
import dataclasses
import hashlib
import importlib.util
import json
import logging
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import polars as pl

from zoo.locations import REGISTRY_VARIABLE

State = Literal["none", "waiting", "making", "ready", "failed", "full"]
WAITING = 50  # pairs in the queue; then the next is asked to come back
EPISODES = 16  # whose returns stand beside a film
SECONDS = 600  # for one pair
MOST_BYTES = 2 * 1024**3  # of all films; then those go that nobody has looked at for longest
_FILM, _RETURNS, _PAIR = "film", "returns.json", "pair.json"
_LOG = logging.getLogger(__name__)

Run = Callable[[Sequence[str]], None]


@dataclasses.dataclass(frozen=True)
class Pair:
    """A robot and a human of one task, by their policies' ids and content."""

    task: str
    robot: str
    human: str
    content: tuple[str, str]  # sha256 of both policies
    env_version: int

    @property
    def key(self) -> str:
        """Name of the pair's folder: another one whenever the film would differ."""
        text = json.dumps([self.task, self.content, self.env_version, self.robot, self.human])
        return hashlib.sha256(text.encode()).hexdigest()[:32]


class Videos:
    """A folder of films, and the one thread that adds to it."""

    def __init__(self, folder: Path, run: Run | None = None) -> None:
        self._folder = folder
        self._run = run or run_command
        self._queue: queue.Queue[Pair] = queue.Queue(WAITING)
        self._lock = threading.Lock()
        self._states: dict[str, State] = {}
        self._thread: threading.Thread | None = None

    def state(self, pair: Pair) -> State:
        """Return how far a pair's film is."""
        if self.film(pair.key) is not None:
            return "ready"
        return self._states.get(pair.key, "none")

    def film(self, key: str) -> Path | None:
        """Return a finished film by its pair's key; a key that is not one finds nothing."""
        if len(key) != 32 or not set(key) <= set("0123456789abcdef"):
            return None
        film = next((self._folder / key).glob(f"{_FILM}.*"), None)
        if film is not None:
            with contextlib.suppress(OSError):
                os.utime(film.parent)  # somebody looks at it
        return film

    def newest(self) -> Pair | None:
        """Return the pair whose film was made last, if there is any."""
        notes = sorted(self._folder.glob(f"*/{_PAIR}"), key=lambda path: path.stat().st_mtime)
        if not notes:
            return None
        fields = json.loads(notes[-1].read_text())
        return Pair(**fields | {"content": tuple(fields["content"])})

    def returns(self, pair: Pair) -> list[float] | None:
        """Return what the pair earned in each episode, once its film is made."""
        path = self._folder / pair.key / _RETURNS
        return json.loads(path.read_text()) if path.is_file() else None

    def ask(self, pair: Pair) -> State:
        """Ask for a film; asking again changes nothing, unless it had failed."""
        with self._lock:
            state = self.state(pair)
            if state in ("ready", "waiting", "making"):
                return state
            try:
                self._queue.put_nowait(pair)
            except queue.Full:
                return "full"
            self._states[pair.key] = "waiting"
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="films", daemon=True)
                self._thread.start()
            return "waiting"

    def wait(self) -> None:
        """Wait until every film that was asked for is made or has failed."""
        self._queue.join()

    def _work(self) -> None:
        while True:
            pair = self._queue.get()
            self._states[pair.key] = "making"
            try:
                self._make(pair)
                self._states.pop(pair.key)
            except Exception:  # whatever it is, the next pair has its turn
                _LOG.exception("no film of %s with %s", pair.robot, pair.human)
                self._states[pair.key] = "failed"
            finally:
                self._queue.task_done()

    def _make(self, pair: Pair) -> None:
        """Fill a folder beside the pair's, which appears under its name when it is whole."""
        self._folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._folder, prefix="making-") as place:
            made, played = Path(place) / "made", Path(place) / "played"
            made.mkdir()
            film = (
                made / f"{_FILM}.{'mp4' if importlib.util.find_spec('imageio_ffmpeg') else 'gif'}"
            )
            self._run(film_command(pair, film))
            self._run(play_command(pair, played))
            table = pl.read_parquet(played / "episodes.parquet").sort("episode")
            (made / _RETURNS).write_text(json.dumps(table["return"].to_list()))
            (made / _PAIR).write_text(json.dumps(dataclasses.asdict(pair)))
            shutil.rmtree(self._folder / pair.key, ignore_errors=True)
            made.replace(self._folder / pair.key)
        self._forget(keep=pair.key)

    def _forget(self, keep: str) -> None:
        """Remove the films that were looked at longest ago, until the others have room."""
        kept = {path: _bytes_of(path) for path in self._folder.iterdir() if path.name != keep}
        total = _bytes_of(self._folder / keep) + sum(kept.values())
        for path in sorted(kept, key=lambda path: path.stat().st_mtime):
            if total <= MOST_BYTES:
                return
            shutil.rmtree(path, ignore_errors=True)
            total -= kept[path]


def _bytes_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def film_command(pair: Pair, out: Path) -> list[str]:
    """Return the command that films a pair's first episode."""
    seats = ("--robot", f"zoo:{pair.robot}", "--human", f"zoo:{pair.human}")
    return [
        "render",
        "--task",
        pair.task,
        *seats,
        "--width",
        "480",
        "--height",
        "360",
        "--out",
        str(out),
    ]


def play_command(pair: Pair, out: Path) -> list[str]:
    """Return the command that plays a pair's episodes."""
    seats = ("--egos", pair.robot, "--partners", pair.human, "--episodes", str(EPISODES))
    return ["crossplay", "--task", pair.task, *seats, "--out", str(out)]


def run_command(arguments: Sequence[str], registry: Path | None = None) -> None:
    """Run a command of `assistax-zoo`, gently: readers of pages come first. It ends with us.

    The policies are the installed registry's if no other is given.
    """
    chosen = {} if registry is None else {REGISTRY_VARIABLE: str(registry.absolute())}
    command = [sys.executable, "-m", "assistax_zoo", *arguments]
    nice = ["nice", "-n", "10"] if shutil.which("nice") else []
    with_us = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
    subprocess.run(
        [*with_us, *nice, *command],
        check=True,
        timeout=SECONDS,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=os.environ | chosen | {"JAX_PLATFORMS": "cpu"},
    )
