"""Play one episode and film it: .mp4, .gif or .webp, or a .png sheet of moments."""

import contextlib
import errno
import functools
import importlib
import itertools
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image

from assistax_base.files import atomic_path
from assistax_envs import Disability, Env, EnvParams, EnvState, disability_params
from assistax_envs.own_settings import key_of, own_settings
from assistax_envs.preferences import check_preferences
from evaluation.cast.seats import Seated, seat_policy
from evaluation.play.jobs import episode_seeds
from zoo.registry import Registry

RATE = 50  # control steps a second
ENDINGS = (".mp4", ".gif", ".webp", ".png")
MOMENTS, SHEET = 4, 12  # pictures in two rows of two, and in a contact sheet of rows of four
VIDEO_HELP = (
    "an .mp4 needs the package imageio-ffmpeg; install it with: pip install "
    "'assistax-zoo[video]', or write .gif"
)

Act = Callable[[np.ndarray], np.ndarray]


def play(
    env: Env,
    robot: Act,
    human: Act,
    disability: str | Disability = "d1",
    seed: int = 0,
    steps: int | None = None,
    on_step: Callable[[], None] | None = None,
    *,
    episode: int = 0,
    preference: str | None = None,
    partner: str | None = None,
    humans: EnvParams | None = None,
    word: Callable[[], Any] | None = None,
) -> Iterator[EnvState]:
    """Yield the states of one episode, each [1], beginning with the start.

    Args:
        env: The environment.
        robot: Function from the robot's observation [O] to its action [A].
        human: The same for the human.
        disability: The human's disability setting.
        seed: Seed of the evaluation that has the episode.
        steps: Number of steps; by default the whole episode.
        on_step: Called after each step.
        episode: Number of the episode in that evaluation.
        preference: The preference of a gentle task's human; by default drawn.
        partner: The human's id, if it is a partner of the zoo, which has its own starts.
        humans: A person's own `EnvParams` [1], in place of a setting and a preference.
        word: Returns the word that the human said with its last action; None if it never speaks.
    """
    key = key_of(np.array(episode_seeds(seed, [episode], partner)))
    preferences = None if preference is None else [preference]
    reset, step = _programs(env)
    state = reset(key, humans or disability_params([disability], preferences))
    yield state
    for _ in range(env.episode_length if steps is None else steps):
        seats = {"robot": robot, "human": human}
        actions = {
            role: np.asarray(act(_observation(state, role)), np.float32)
            for role, act in seats.items()
        }
        said = {} if word is None else {"word": np.array([word()], np.int32)}
        state = step(state, {role: action[None] for role, action in actions.items()} | said)
        if on_step is not None:
            on_step()
        yield state


@own_settings()
def _observation(state: EnvState, role: str) -> np.ndarray:
    return np.asarray(state.obs[role][0])


class Pair:
    """A robot and a human by reference, for episodes to film or record."""

    def __init__(
        self,
        env: Env,
        robot: str,
        human: str,
        registry: Callable[[], Registry],
        *,
        steps: int | None = None,
        seed: int = 0,
        disability: str | None = None,
        preference: str | None = None,
    ) -> None:
        """Load both policies and check that they fit; `play` plays the episodes.

        Args:
            env: The environment.
            robot: Reference of the robot, as in `seat_policy`.
            human: Reference of the human, as in `seat_policy`.
            registry: Returns the registry; called only if it is needed.
            steps: Steps of each episode; by default all of them.
            seed: Seed of the evaluation that has the episodes.
            disability: The human's setting instead of its own.
            preference: The preference of a gentle task's human; by default drawn.
        """
        if preference is not None:
            check_preferences(env.task, [preference])
        self.length = env.episode_length if steps is None else steps
        if not 1 <= self.length <= env.episode_length:
            raise ValueError(f"steps is {steps}; allowed are 1 to {env.episode_length}, an episode")
        self.env, self.references = env, {"robot": robot, "human": human}
        self._registry, self._seed, self._preference = registry, seed, preference
        self.seats = self._seated(0)
        if self.seats["human"].humans is not None and (disability or preference):
            raise ValueError(
                f"{human} is a person with its own body and preferences; leave disability and "
                "preference out"
            )
        self.setting = disability or self.seats["human"].setting or "d1"

    def _seated(self, episode: int) -> dict[str, Seated]:
        """Return newly loaded policies, without memory of earlier episodes."""
        seed = self._seed + episode  # of random actions
        return {
            role: seat_policy(name, role, self.env, self._registry, self.env.task, seed)
            for role, name in self.references.items()
        }

    def play(
        self,
        check: Callable[[], None],
        on_step: Callable[[], None] | None = None,
        episode: int = 0,
        heard: Callable[[str, Act], Act] = lambda role, act: act,
    ) -> Iterator[EnvState]:
        """Yield the states of one episode.

        After each step `check` is called, which may raise to stop, then `on_step`. `heard` may wrap
        each role's function of actions, to record them.
        """

        def stepped() -> None:
            check()
            if on_step is not None:
                on_step()

        seats = self._seated(episode) if episode else self.seats
        acting = (heard(role, act) for role, act in seats.items())
        human = self.seats["human"]
        partner = None if human.card is None else human.card.id
        options: dict[str, Any] = {"episode": episode, "preference": self._preference}
        options |= {"partner": partner, "humans": human.humans, "word": seats["human"].word}
        yield from play(
            self.env, *acting, self.setting, self._seed, self.length, stepped, **options
        )


@functools.lru_cache(1)
def _programs(env: Env) -> tuple[Callable[..., EnvState], Callable[..., EnvState]]:
    """Return the compiled reset and step of an environment, kept for the next episodes."""
    own = own_settings()
    return own(jax.jit(env.reset)), own(jax.jit(env.step))


def check_film(path: Path, fps: int, width: int, height: int) -> None:
    """Check, before any work, that a film can be written under this name.

    Raises:
        ValueError: The ending is unknown, the size or the rate is not possible, the package for
            .mp4 is missing, or the place cannot be written to.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ValueError(
            f"{path.name} ends in {path.suffix or 'nothing'!r}; pictures are written as "
            f"{', '.join(ENDINGS)}"
        )
    rates = [rate for rate in range(1, RATE + 1) if RATE % rate == 0]
    if fps not in rates:
        raise ValueError(
            f"fps is {fps}; allowed are {', '.join(map(str, rates))}, which divide {RATE} steps a "
            "second"
        )
    if ending == ".mp4":
        if width % 2 or height % 2:
            raise ValueError(
                f"the size is {width}x{height}; an .mp4 needs an even width and height"
            )
        _ffmpeg()
    check_place(path)


def check_place(path: Path) -> None:
    """Check, before any work, that a file can be written under this name.

    Raises:
        ValueError: It cannot be written.
    """
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ValueError(
            f"{path} cannot be written ({error.strerror or error}); name a file in another folder"
        ) from error


def film(
    states: Iterable[EnvState],
    draw: Callable[[EnvState], np.ndarray],
    path: Path,
    steps: int,
    fps: int = 25,
    count: int = MOMENTS,
) -> int:
    """Draw an episode and write it, in real time; return the number of frames.

    Args:
        states: The `steps` + 1 states of the episode.
        draw: Function from a state to an image, uint8 [H, W, 3].
        path: A path that ends in .mp4, .gif, .webp or .png. A .png has `count` moments, the last
            one at the end.
        steps: Number of steps of the episode.
        fps: Frames a second; a divisor of 50.
        count: Number of moments.
    """
    ending = path.suffix.lower()
    shown = moments(steps, count) if ending == ".png" else range(0, steps + 1, RATE // fps)
    frames = (draw(state) for step, state in enumerate(states) if step in shown)
    with atomic_path(path) as temporary:
        write = {".mp4": _write_mp4, ".gif": _write_gif, ".webp": _write_webp, ".png": _write_sheet}
        write[ending](frames, temporary, fps)
    return len(shown)


def moments(steps: int, count: int = MOMENTS) -> Sequence[int]:
    """Return the steps of a sheet's moments, denser at the beginning; the last is the end."""
    return sorted({round(steps * ((i + 1) / count) ** 2) for i in range(count)})


def _write_mp4(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    first = next(frames)
    height, width = first.shape[:2]
    source = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{width}x{height}",
        "-r",
        str(fps),
        "-i",
        "-",
    ]
    target = ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-f", "mp4", str(path)]
    command = [_ffmpeg().get_ffmpeg_exe(), "-y", "-loglevel", "error", *source, *target]
    with tempfile.TemporaryFile() as log:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=log) as process:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # its exit code and its message say more
                for frame in itertools.chain([first], frames):
                    process.stdin.write(np.ascontiguousarray(frame).data)
                process.stdin.close()
        if process.returncode:
            log.seek(0)
            message = " ".join(log.read().decode(errors="replace").split())
            raise ValueError(
                f"ffmpeg could not write the film ({message[:200]}); write a .gif instead"
            )


def _write_gif(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    """Write a GIF whose frames share the first one's palette, so that only changes are stored.

    The first frame has all colours, because the legend below it shows each of them.
    """
    first = Image.fromarray(next(frames)).quantize(method=Image.Quantize.MAXCOVERAGE)
    pictures = (
        Image.fromarray(frame).quantize(palette=first, dither=Image.Dither.NONE) for frame in frames
    )
    first.save(path, "GIF", save_all=True, append_images=pictures, duration=1000 // fps, loop=0)


def _write_webp(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    """Write an animated WebP, with a fifth of a GIF's bytes."""
    first, *rest = map(Image.fromarray, frames)
    options = {"save_all": True, "append_images": rest, "duration": 1000 // fps, "loop": 0}
    first.save(path, "WEBP", quality=40, method=6, **options)


def _write_sheet(frames: Iterator[np.ndarray], path: Path, fps: int) -> None:
    panes = list(frames)
    empty = np.full_like(panes[0], 255)
    # Four side by side are too small on a page.
    across = MOMENTS if len(panes) > MOMENTS else 2
    panes += [empty] * (-len(panes) % across)
    starts = range(0, len(panes), across)
    rows = [np.concatenate(panes[start : start + across], axis=1) for start in starts]
    Image.fromarray(np.concatenate(rows)).save(path, "PNG", optimize=True)


def _ffmpeg() -> Any:
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise ValueError(VIDEO_HELP) from error
