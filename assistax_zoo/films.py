"""Films of an episode."""

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_zoo.zoos import Zoo, open_zoo

if TYPE_CHECKING:
    from evaluation.film import Pair
    from zoo.registry import Registry


def render(
    robot: str,
    human: str,
    out: Path | str,
    *,
    task: str,
    steps: int | None = None,
    seed: int = 0,
    disability: str | None = None,
    preference: str | None = None,
    camera: str | None = None,
    fps: int = 25,
    width: int = 640,
    height: int = 480,
    sheet: bool = False,
    zoo: "str | Path | Zoo | None" = None,
    on_step: Callable[[], None] | None = None,
) -> Path:
    """Film an episode of a robot and a human, with targets, force and reward; return `out`.

    Args:
        robot: An id, a .safetensors or .onnx file, python:..., "zero" or "random".
        human: An id, a .safetensors file, "zero" or "random".
        out: File to write: .mp4, .gif or .webp in real time, or .png with four moments.
        task: Task, such as "scratch".
        steps: Steps of 20 ms to show; default the whole episode.
        seed: Seed of the episode: where it starts.
        disability: The human's setting, d1 to d9, instead of its own.
        preference: Preference of the human of a gentle task, p1 to p9; default drawn.
        camera: A camera of the scene, such as "side", or "close" to follow the tool.
        fps: Frames a second, a divisor of 50.
        width: Pixels of a frame.
        height: Pixels of a frame.
        sheet: Write beside an .mp4 a .gif, and beside either a .png of twelve moments.
        zoo: Where ids are looked up, as in `open_zoo`.
        on_step: Called after each step.

    Raises:
        ValueError: A policy does not fit its seat, or a film of this kind cannot be written here.
        ZooError: A policy is not there, or not what it says.
        RenderError: This machine has no OpenGL.

    Examples:
        >>> size = {"width": 64, "height": 48}
        >>> render("zero", "random", "film.png", task="scratch", steps=2, **size).name
        'film.png'
    """
    from assistax_envs import make
    from assistax_envs.interrupts import interruptible
    from evaluation.cast.seats import version_of
    from evaluation.film import Pair

    rates = _rates(Path(out), fps, (width, height), sheet)
    who = {"disability": disability, "preference": preference}

    def registry() -> "Registry":
        return open_zoo(zoo).registry

    version = version_of({"robot": robot, "human": human}, task, registry)
    env = make(task, "native", version=version)
    pair = Pair(env, robot, human, registry, steps=steps, seed=seed, **who)
    caption = (f"robot {robot}", f"human {human}")
    size = {"camera": camera, "width": width, "height": height, "caption": caption}
    interruptible(lambda check: _film(pair, rates, size, sheet, check, on_step))
    return Path(out)


def _rates(out: Path, fps: int, size: tuple[int, int], sheet: bool) -> dict[Path, int]:
    """Return the files to write and the frames a second of each, checked."""
    from evaluation.film import check_film

    rates = {out: fps}
    if sheet and out.suffix.lower() == ".mp4":
        rates[out.with_suffix(".gif")] = fps
    if sheet:
        rates[out.with_suffix(".png")] = fps
    for path, rate in rates.items():
        check_film(path, rate, *size)
    return rates


def _film(
    pair: "Pair",
    rates: Mapping[Path, int],
    size: Mapping[str, Any],
    sheet: bool,
    check: Callable[[], None],
    on_step: Callable[[], None] | None,
) -> None:
    """Play the episode, and draw it for each file; `check` is called often."""
    from evaluation.film import MOMENTS, SHEET, film

    def draw(state: Any) -> Any:
        check()
        return pair.env.render(state, **size)

    states = pair.play(check, on_step)
    if sheet:
        states = list(states)  # played once, drawn for each file
    with contextlib.closing(pair.env):  # in this thread, which drew
        for path, rate in rates.items():
            film(states, draw, path, pair.length, rate, SHEET if sheet else MOMENTS)
