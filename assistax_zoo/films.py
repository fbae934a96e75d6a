"""Films of an episode."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from assistax_zoo.zoos import Zoo, open_zoo


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
        out: File to write: .mp4 or .gif in real time, or .png with four moments.
        task: Task, such as "scratch".
        steps: Steps of 20 ms to show; default the whole episode.
        seed: Seed of the episode: where it starts.
        disability: The human's setting, d1 to d9, instead of its own.
        preference: What the human of a gentle task likes, p1 to p9; default drawn.
        camera: A camera of the scene, such as "side", or "close" to follow the tool.
        fps: Frames a second, a divisor of 50.
        width: Pixels of a frame.
        height: Pixels of a frame.
        sheet: Write beside an .mp4 a .gif of a tenth of a second a frame, and beside either a .png
            of twelve moments.
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
    from assistax_envs.preferences import check_preferences
    from evaluation.film import MOMENTS, SHEET, check_film, film, play
    from evaluation.partners import seat_policy

    out = Path(out)
    rates = {out: fps}
    if sheet and out.suffix.lower() == ".mp4":
        rates[out.with_suffix(".gif")] = 10
    if sheet:
        rates[out.with_suffix(".png")] = fps
    for path, rate in rates.items():
        check_film(path, rate, width, height)
    if preference is not None:
        check_preferences(task, [preference])
    env = make(task, "native")
    length = env.episode_length if steps is None else steps
    if not 1 <= length <= env.episode_length:
        raise ValueError(f"steps is {steps}; allowed are 1 to {env.episode_length}, an episode")
    registry = lambda: open_zoo(zoo).registry  # noqa: E731 - read where a reference asks for it
    act = [
        seat_policy(reference, role, env, registry, task, seed)
        for role, reference in (("robot", robot), ("human", human))
    ]
    setting = disability or getattr(act[1], "setting", None) or "d1"
    caption = (f"robot {robot}", f"human {human}")
    size: dict[str, Any] = {"camera": camera, "width": width, "height": height, "caption": caption}

    def work(check: Callable[[], None]) -> None:
        def stepped() -> None:
            check()
            if on_step is not None:
                on_step()

        def draw(state: Any) -> Any:
            check()
            return env.render(state, **size)

        states = play(env, *act, setting, seed, length, stepped, preference=preference)
        if sheet:
            states = list(states)  # played once, drawn for each file
        with contextlib.closing(env):  # in this thread, which drew
            for path, rate in rates.items():
                film(states, draw, path, length, rate, SHEET if sheet else MOMENTS)

    interruptible(work)
    return out
