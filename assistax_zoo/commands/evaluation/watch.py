"""The command that shows an episode: in MuJoCo's viewer, or as a page that plays it."""

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_zoo.commands.evaluation.render import EPISODE
from assistax_zoo.shell.console import stdout_is_data, step_progress

if TYPE_CHECKING:
    from evaluation.player.episode import Episode

PAGE, PACKED = ".html", ".episode"
DEFAULT_PAGE = Path("watch.html")


def watch(
    robot: str,
    human: str | None = None,
    /,
    *,
    task: str | None = None,
    out: Path | None = None,
    steps: int | None = None,
    seed: int = 0,
    episode: int = 0,
    disability: str | None = None,
    preference: str | None = None,
    registry: str | None = None,
) -> None:
    """Watch a robot and a person: the scene, the person's preferences, forces and reward over time.

    Where there is a display, MuJoCo's viewer opens. Elsewhere, or with --out, one page is written
    that plays the episode in a browser and loads nothing from elsewhere.

    Args:
        robot: An id, a .safetensors or .onnx file, python:FILE.py:FACTORY, zero, or random; or
            alone a file that `trajectories` wrote.
        human: An id, also of a person, a .safetensors file, zero, or random.
        task: Task, if no id says it.
        out: Page to write, .html; or .episode, which players of other pages load. Default:
            watch.html, or the next free name, watch-2.html.
        steps: Steps of 20 ms to play; the whole episode of 1000 if not given.
        seed: Seed of the episode.
        episode: Which episode of a file.
        disability: The human's setting, d1 to d9, instead of its own.
        preference: Preference of the human of a gentle task, p1 to p9; drawn if not given.
        registry: Registry to read instead of the installed one: a file, a folder or an address.

    Example:
        assistax-zoo watch random gentle_scratch/person-00042 --out watch.html
    """
    chosen = {"steps": steps, "disability": disability, "preference": preference}
    with stdout_is_data():
        from evaluation.cast.robot_names import task_of
        from evaluation.player.viewer import has_display, view

        _check(robot, human, out, {**chosen, "task": task, "seed": seed or None}, episode)
        if human is None:
            shown = _read(Path(robot), episode)
        else:
            task = task or task_of((robot, human))
            shown = _play(task, robot, human, {**chosen, "seed": seed, "zoo": registry})
        if out is None and has_display():
            view(shown)
            return
        path = _write(shown, out or _free(DEFAULT_PAGE))
    print(path)


def _check(
    robot: str,
    human: str | None,
    out: Path | None,
    playing: dict[str, Any],
    episode: int,
) -> None:
    """Check the arguments before any work is done."""
    from evaluation.film import check_place

    if human is None and not Path(robot).is_file():
        raise ValueError(f"no recording is at {robot}; give a robot and a human, or such a file")
    if human is None and (given := [name for name, value in playing.items() if value]):
        raise ValueError(f"{robot} is a recording, as it was played; leave out {', '.join(given)}")
    if human is not None and episode:
        raise ValueError("episode is for recordings; choose another seed to play another episode")
    if out is not None and out.suffix.lower() not in (PAGE, PACKED):
        raise ValueError(
            f"{out.name} ends in {out.suffix or 'nothing'!r}; allowed are {PAGE} and {PACKED}"
        )
    check_place(out or DEFAULT_PAGE)


def _play(task: str, robot: str, human: str, chosen: dict[str, Any]) -> "Episode":
    """Play one episode, recorded as any other."""
    from assistax_zoo.recording import trajectories

    with (
        tempfile.TemporaryDirectory(prefix="watch-") as folder,
        step_progress(f"play {task}", chosen["steps"] or EPISODE) as advance,
    ):
        out = Path(folder) / "episode.trajectory"
        options: dict[str, Any] = {"episodes": 1, "backend": "native", **chosen}
        options["on_step"] = lambda: advance(1)
        trajectories(robot, human, task=task, out=out, **options)
        return _read(out, 0)


def _free(path: Path) -> Path:
    """Return the path, numbered if there is a file of that name: nothing is overwritten unasked."""
    names = (path, *(path.with_stem(f"{path.stem}-{number}") for number in range(2, 1000)))
    return next((name for name in names if not name.exists()), path)


def _read(path: Path, number: int) -> "Episode":
    from evaluation.player.episode import read_episode

    return read_episode(path, number)


def _write(shown: "Episode", path: Path) -> Path:
    from assistax_base.files import atomic_write
    from evaluation.player.episode import episode_content
    from evaluation.player.page import pack, write_episode

    content = episode_content(shown)
    if path.suffix.lower() == PACKED:
        atomic_write(path, pack(content))
    else:
        write_episode(content, path)
    return path
