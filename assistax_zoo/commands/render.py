"""Pictures and films of an episode."""

from pathlib import Path

from assistax_zoo.console import progress, stdout_is_data


def render(
    *,
    task: str,
    robot: str | None = None,
    human: str | None = None,
    out: Path,
    collisions: bool = False,
    steps: int | None = None,
    seed: int = 0,
    camera: str | None = None,
    fps: int = 25,
    width: int = 640,
    height: int = 480,
    disability: str | None = None,
    registry: Path | None = None,
) -> None:
    """Film an episode of a robot and a human, with targets, contact force and reward drawn on; no display is needed.

    The human plays under its own disability setting. An .mp4 or .gif runs in real time, a .png
    shows four moments. With --collisions no episode is played: a .png shows the scene beside the
    shapes that can touch, with the pairs.

    Args:
        task: Task, such as scratch; with --collisions also all.
        robot: zoo:ID, a .safetensors file, zero, random, python:package.module:factory, or
            onnx:FILE.
        human: zoo:ID, a .safetensors file, zero, or random.
        out: File to write: .mp4, .gif or .png.
        collisions: Draw what can touch what, instead of an episode; takes no robot, no human and
            nothing but the size.
        steps: Steps of 20 ms to show; the whole episode of 1000 if not given.
        seed: Seed of the episode: where it starts.
        camera: A camera of the scene, such as side, or close to follow the tool.
        fps: Frames a second.
        width: Pixels of a frame.
        height: Pixels of a frame.
        disability: The human's setting, d1 to d9, instead of its own.
        registry: Registry to read instead of the installed one.

    Example:
        assistax-zoo render --task scratch --robot zoo:scratch/ippo-d1-s7-v1/robot --human random
        --out scratch.mp4
    """
    if collisions:
        _render_collisions(task, out, width, height)
        return
    if robot is None or human is None:
        raise ValueError(
            f"{'robot' if robot is None else 'human'} is missing; an episode needs --robot and "
            "--human"
        )
    with stdout_is_data():
        import functools

        from assistax_envs import make
        from evaluation.partners import seat_policy
        from evaluation.replay import check_film, film, play
        from zoo.registry import load_registry

        check_film(out, fps, width, height)
        env = make(task, "native")
        length = env.episode_length if steps is None else steps
        if not 1 <= length <= env.episode_length:
            raise ValueError(f"steps is {steps}; allowed are 1 to {env.episode_length}, an episode")
        zoo = functools.partial(load_registry, registry)
        players = {
            role: seat_policy(reference, role, env, zoo, task, seed)
            for role, reference in (("robot", robot), ("human", human))
        }
        setting = disability or getattr(players["human"], "disability", None) or "d1"
        draw = functools.partial(
            env.render,
            camera=camera,
            width=width,
            height=height,
            caption=(f"robot {robot}", f"human {human}"),
        )
        with progress(f"render {task}", length) as advance:
            states = play(
                env,
                players["robot"],
                players["human"],
                setting,
                seed,
                length,
                on_step=lambda: advance(1),
            )
            film(states, draw, out, length, fps)
    print(out)


def _render_collisions(task: str, out: Path, width: int, height: int) -> None:
    from assistax_envs.versions import TASKS

    if task != "all" and task not in TASKS:
        raise ValueError(f"task is {task!r}; allowed are all, {', '.join(TASKS)}")
    if out.suffix.lower() != ".png":
        raise ValueError(
            f"{out.name} ends in {out.suffix or 'nothing'!r}; collisions are drawn as a .png"
        )
    with stdout_is_data():
        from PIL import Image

        from assistax_envs.collisions import picture
        from evaluation.replay import check_film
        from evaluation.tables import atomic_path

        check_film(out, 25, width, height)
        pixels = picture(TASKS if task == "all" else (task,), width, height)
        with atomic_path(out) as temporary:
            Image.fromarray(pixels).quantize(256).save(temporary, format="png", optimize=True)
    print(out)
