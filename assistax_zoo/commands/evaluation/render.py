"""Episodes of a pair: pictures, films, and tables of steps."""

from pathlib import Path

from assistax_zoo.shell.console import answer, stdout_is_data, step_progress

EPISODE = 1000  # steps


def render(
    *,
    task: str,
    robot: str,
    human: str,
    out: Path,
    steps: int | None = None,
    seed: int = 0,
    camera: str | None = None,
    fps: int = 25,
    width: int = 640,
    height: int = 480,
    disability: str | None = None,
    preference: str | None = None,
    sheet: bool = False,
    registry: str | None = None,
) -> None:
    """Film an episode of a robot and a human, with targets, touches and the reward of each step.

    No display is needed. An .mp4, .gif or .webp runs in real time, a .png shows four moments.

    Args:
        task: Task, such as scratch.
        robot: An id, a .safetensors or .onnx file, python:FILE.py:FACTORY, zero, or random.
        human: An id, a .safetensors file, zero, or random.
        out: File to write: .mp4, .gif, .webp or .png.
        steps: Steps of 20 ms to show; the whole episode of 1000 if not given.
        seed: Seed of the episode.
        camera: A camera of the scene, such as side, or close to follow the tool.
        fps: Frames a second.
        width: Pixels of a frame.
        height: Pixels of a frame.
        disability: The human's setting, d1 to d9, instead of its own.
        preference: Preference of the human of a gentle task, p1 to p9; drawn if not given.
        sheet: Write a .png of twelve moments beside the film, and a .gif beside an .mp4.
        registry: Registry to read instead of the installed one: a file, a folder or an address.

    Example:
        assistax-zoo render --task scratch --robot random --human random --out scratch.mp4
    """
    with stdout_is_data():
        from assistax_zoo.films import render as film

        size = {"fps": fps, "width": width, "height": height, "camera": camera}
        with step_progress(f"render {task}", steps or EPISODE) as advance:
            film(
                robot,
                human,
                out,
                task=task,
                steps=steps,
                seed=seed,
                disability=disability,
                preference=preference,
                sheet=sheet,
                zoo=registry,
                on_step=lambda: advance(1),
                **size,
            )
    print(out)


def trajectories(
    *,
    task: str,
    robot: str,
    human: str,
    out: Path,
    episodes: int = 8,
    steps: int | None = None,
    seed: int = 0,
    disability: str | None = None,
    preference: str | None = None,
    backend: str = "auto",
    registry: str | None = None,
    format: str = "parquet",
    json: bool = False,
) -> None:
    """Record a robot and a human step by step: for imitation and for studies.

    docs/trajectories.md lists the columns. Who played what is in the file's metadata.

    Args:
        task: Task, such as scratch.
        robot: An id, a .safetensors or .onnx file, python:FILE.py:FACTORY, zero, or random.
        human: An id, a .safetensors file, zero, or random.
        out: File to write; a new folder where the format is not parquet.
        episodes: How many.
        steps: Steps of 20 ms of each; the whole episode of 1000 if not given.
        seed: Seed of the episodes.
        disability: The human's setting, d1 to d9, instead of its own.
        preference: Preference of a gentle task's human, p1 to p9; else drawn each episode.
        backend: fused, native, mjx, mjx-warp, or auto for the fastest here.
        registry: Registry to read instead of the installed one: a file, a folder or an address.
        format: parquet; or minari or lerobot (version 3.0), each an extra of its name.
        json: Print JSON.

    Example:
        assistax-zoo trajectories --task scratch --robot scratch/ippo-d1-s7-v1/robot
        --human scratch/ippo-d1-s7-v1/human --episodes 8 --out pair.parquet
    """
    with stdout_is_data():
        from assistax_zoo.recording import trajectories as record

        with step_progress(f"record {task}", episodes * (steps or EPISODE)) as advance:
            table = record(
                robot,
                human,
                task=task,
                out=out,
                episodes=episodes,
                steps=steps,
                seed=seed,
                disability=disability,
                preference=preference,
                backend=backend,
                zoo=registry,
                format=format,
                on_step=lambda: advance(1),
            )
    content = {"out": out, "episodes": episodes, "steps": table.height - episodes}
    answer(json, content, f"wrote {content['steps']} steps of {episodes} episodes to {out}")
