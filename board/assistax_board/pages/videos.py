"""Films of public pairs and of robots that were handed in, made when somebody asks, then kept.

A film is made by the command line in a process of its own, one at a time: whatever goes wrong
there, or takes too long, the pages stay up. Nobody hidden is in any: seats are filled from the
registry, and from files that were handed in.
"""

import contextlib
import dataclasses
import importlib.util
import json
import logging
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, Protocol

import polars as pl

from assistax_base.digest import json_sha256
from assistax_base.errors import ZooError
from assistax_board.store.shown import Submission
from zoo.locations import REGISTRY_VARIABLE
from zoo.registry import Registry
from zoo.schema import PolicyEntry

State = Literal["none", "waiting", "making", "ready", "failed", "full"]
WAITING = 50  # films in the queue; then the next is asked to come back
FILMS_FOLDER = "films"  # in a data folder
ROBOT = "robot-"  # how keys of robots' films begin: those of erased files are removed
EPISODES = 16  # whose returns stand beside a film
AGAIN_SECONDS = 3600.0  # after which a film of a published robot that failed is asked for again
SECONDS = 3600  # for one command, which gets what time robots that are scored leave
MOST_BYTES = 2 * 1024**3  # of all films; then those go that nobody has looked at for longest
_FILM, _RETURNS, _EPISODE = "film", "returns.json", "shown.episode"
_LOG = logging.getLogger(__name__)

_KEY = re.compile(rf"({ROBOT})?[0-9a-f]{{32}}")

Run = Callable[[Sequence[str], Path], None]  # (arguments, folder in which they are understood)


class Filmed(Protocol):
    """Subject of a film."""

    @property
    def key(self) -> str:
        """Name of the film's folder: another one whenever the film would differ."""
        ...

    def make(self, run: Run, film: Path, place: Path) -> None:
        """Write the film and its files beside it; `place` is a folder for temporary files.

        Both are absolute.
        """
        ...


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
        seats = self.content, self.env_version, self.robot, self.human
        return json_sha256([self.task, *seats])[:32]

    def make(self, run: Run, film: Path, place: Path) -> None:
        """Film the pair's first episode, and play more for the returns beside it."""
        seats = self.task, f"zoo:{self.robot}", self.human
        run(film_command(*seats, film), place)
        run(watch_command(*seats, film.with_name(_EPISODE)), place)
        run(play_command(self, place / "played"), place)
        table = pl.read_parquet(place / "played" / "episodes.parquet").sort("episode")
        (film.parent / _RETURNS).write_text(json.dumps(table["return"].to_list()))


@dataclasses.dataclass(frozen=True)
class HandedIn:
    """A robot's file that was handed in, with a published human."""

    task: str
    robot: str  # sha256 of the file
    human: str
    content: str  # sha256 of the human's policy
    env_version: int
    read: Callable[[str], bytes] = dataclasses.field(compare=False)  # sha256 -> the file

    @property
    def key(self) -> str:
        """Name of the film's folder: another one whenever the film would differ."""
        seats = self.robot, self.human, self.content
        return f"{ROBOT}{json_sha256([self.task, *seats, self.env_version])[:32]}"

    def make(self, run: Run, film: Path, place: Path) -> None:
        """Film one episode, and store the data that its player shows."""
        from assistax_board.robots.admission import is_safetensors

        data = self.read(self.robot)
        # Films show what a robot is called: never a folder of this machine.
        name = f"{self.robot[:12]}.{'safetensors' if is_safetensors(data) else 'onnx'}"
        (place / name).write_bytes(data)
        seats = self.task, name, self.human
        run(film_command(*seats, film), place)
        run(watch_command(*seats, film.with_name(_EPISODE)), place)


class Videos:
    """A folder of films, and the one thread that adds to it."""

    def __init__(self, folder: Path, run: Run | None = None) -> None:
        self._folder = folder.absolute()
        self._run = run or run_command
        self._queue: queue.Queue[Filmed] = queue.Queue(WAITING)
        self._lock = threading.Lock()
        self._states: dict[str, State] = {}
        self._thread: threading.Thread | None = None

    def state(self, filmed: Filmed) -> State:
        """Return how far a film is."""
        if self.film(filmed.key) is not None:
            return "ready"
        return self._states.get(filmed.key, "none")

    def film(self, key: str) -> Path | None:
        """Return a finished film by its key; a key that is not one finds nothing."""
        if not _KEY.fullmatch(key):
            return None
        film = next((self._folder / key).glob(f"{_FILM}.*"), None)
        if film is not None:
            with contextlib.suppress(OSError):
                os.utime(film.parent)  # somebody looks at it
        return film

    def episode(self, key: str) -> Path | None:
        """Return the data that a player shows of a finished film; empty for older versions."""
        film = self.film(key)
        path = None if film is None else film.with_name(_EPISODE)
        return path if path is not None and path.is_file() else None

    def returns(self, pair: Pair) -> list[float] | None:
        """Return the pair's return in each episode, once its film is made."""
        path = self._folder / pair.key / _RETURNS
        return json.loads(path.read_text()) if path.is_file() else None

    def ask(self, filmed: Filmed) -> State:
        """Ask for a film; asking again changes nothing, unless it had failed."""
        with self._lock:
            state = self.state(filmed)
            if state in ("ready", "waiting", "making"):
                return state
            try:
                self._queue.put_nowait(filmed)
            except queue.Full:
                return "full"
            self._states[filmed.key] = "waiting"
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="films", daemon=True)
                self._thread.start()
            return "waiting"

    def wait(self) -> None:
        """Wait until every film that was asked for is made or has failed."""
        self._queue.join()

    def _work(self) -> None:
        while True:
            filmed = self._queue.get()
            self._states[filmed.key] = "making"
            try:
                self._make(filmed)
                self._states.pop(filmed.key)
            except Exception:  # whatever it is, the next one has its turn
                _LOG.exception("no film %s", filmed.key)
                self._states[filmed.key] = "failed"
            finally:
                self._queue.task_done()

    def _make(self, filmed: Filmed) -> None:
        """Fill a folder beside the film's, which appears under its name when it is whole."""
        self._folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._folder, prefix="making-") as place:
            made = Path(place) / "made"
            made.mkdir()
            ending = "mp4" if importlib.util.find_spec("imageio_ffmpeg") else "gif"
            filmed.make(self._run, made / f"{_FILM}.{ending}", Path(place))
            shutil.rmtree(self._folder / filmed.key, ignore_errors=True)
            made.replace(self._folder / filmed.key)
        self._make_room(keep=filmed.key)

    def _make_room(self, keep: str) -> None:
        """Remove the films that were looked at longest ago, until the others have room."""
        sizes = {path: _bytes_of(path) for path in self._folder.iterdir() if path.name != keep}
        total = _bytes_of(self._folder / keep) + sum(sizes.values())
        for path in sorted(sizes, key=lambda path: path.stat().st_mtime):
            if total <= MOST_BYTES:
                return
            shutil.rmtree(path, ignore_errors=True)
            total -= sizes[path]


@dataclasses.dataclass(frozen=True)
class Shown:
    """A film of a published robot, or how far it is."""

    submission: Submission
    human: str  # name of its partner
    state: State
    film: str | None  # address; None until it is made
    is_gif: bool


class PublishedFilms:
    """Films of the zoo's robots, one of each method, made once and shown on the home page.

    Each robot is filmed with the same partner of its task's training side, as robots that labs hand
    in are. Nobody waits for a film: it is made in the background, and the page says how far it is.
    """

    def __init__(self, registry: Registry, videos: Videos) -> None:
        self._registry, self._videos = registry, videos
        self._humans: dict[str, PolicyEntry | None] = {}
        self._pairs: dict[tuple[str, str], Pair | None] = {}
        self._asked: dict[str, float] = {}  # when, by the film's key

    def human(self, task: str) -> PolicyEntry | None:
        """Return the partner of all films of a task; None if all public partners count."""
        if task not in self._humans:
            teams = self._registry.split(task).train
            human = self._registry.policy(f"{min(teams)}/human") if teams else None
            self._humans[task] = human
        return self._humans[task]

    def pair(self, task: str, robot: str) -> Pair | None:
        """Return a published robot with its partner; None if the registry has no such robot."""
        if (task, robot) not in self._pairs:
            pair = None
            with contextlib.suppress(ZooError):
                seat, human = self._registry.policy(f"{task}/{robot}/robot"), self.human(task)
                if human is not None:
                    version = self._registry.env_version(seat)
                    content = seat.sha256, human.sha256
                    pair = Pair(task, seat.id, human.id, content, version)
            self._pairs[task, robot] = pair
        return self._pairs[task, robot]

    def shown(self, submission: Submission) -> Shown | None:
        """Return the film of a published robot; the first call asks for it."""
        pair = self.pair(submission.task, submission.reference or "")
        if pair is None:
            return None
        state, now = self._videos.state(pair), time.monotonic()
        is_due = now > self._asked.get(pair.key, -AGAIN_SECONDS) + AGAIN_SECONDS
        if state == "none" or (state == "failed" and is_due):
            self._asked[pair.key] = now
            state = self._videos.ask(pair)
        film = self._videos.film(pair.key)
        address = f"/films/{pair.key}" if film else None
        is_gif = film is not None and film.suffix == ".gif"
        return Shown(submission, pair.human.split("/")[1], state, address, is_gif)


def erase_robots(folder: Path) -> None:
    """Remove the films of robots that were handed in: an erased file must not live on in one.

    Who looks at another one asks for it anew.
    """
    for film in folder.glob(f"{ROBOT}*"):
        shutil.rmtree(film, ignore_errors=True)


def _bytes_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def film_command(task: str, robot: str, human: str, out: Path) -> list[str]:
    """Return the command that films the first episode of a robot with a published human."""
    seats = ("--robot", robot, "--human", f"zoo:{human}")
    return [
        "render",
        "--task",
        task,
        *seats,
        "--width",
        "480",
        "--height",
        "360",
        "--out",
        str(out),
    ]


def watch_command(task: str, robot: str, human: str, out: Path) -> list[str]:
    """Return the command that writes the same episode for the player."""
    return ["watch", robot, f"zoo:{human}", "--task", task, "--out", str(out)]


def play_command(pair: Pair, out: Path) -> list[str]:
    """Return the command that plays a pair's episodes."""
    seats = ("--robots", pair.robot, "--humans", pair.human, "--episodes", str(EPISODES))
    return ["crossplay", "--task", pair.task, *seats, "--out", str(out)]


def run_command(arguments: Sequence[str], folder: Path, registry: Path | None = None) -> None:
    """Run a command of `assistax-zoo`, gently: readers of pages come first. It ends with us.

    The policies are the installed registry's if no other is given.
    """
    chosen = {} if registry is None else {REGISTRY_VARIABLE: str(registry.absolute())}
    command = [sys.executable, "-m", "assistax_zoo", *arguments]
    nice = ["nice", "-n", "10"] if shutil.which("nice") else []
    with_us = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
    subprocess.run(
        [*with_us, *nice, *command],
        cwd=folder,
        check=True,
        timeout=SECONDS,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=os.environ | chosen | {"JAX_PLATFORMS": "cpu"},
    )
