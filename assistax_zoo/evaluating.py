"""M_test of robots, and the cross-play of a population."""

import contextlib
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from assistax_base.cluster import RayCluster
from assistax_zoo.results import CrossPlayResult, EvaluationResult, TemporaryFolder
from assistax_zoo.shell.console import StudyLine, chosen_progress, command_line
from assistax_zoo.zoos import Zoo, open_zoo
from evaluation.cast.cast import Cast, choose_partners, leaves_the_choice
from evaluation.cast.robot_names import parse_reference, task_of
from evaluation.crossplay import cast_population
from evaluation.crossplay import cross_play as play_population
from evaluation.evaluate import cast_robots
from evaluation.evaluate import evaluate as evaluate_cast
from evaluation.play.evaluator import check_folder
from evaluation.play.how import PlaySettings
from evaluation.play.progress import Progress
from evaluation.play.shares import ShareDone, run_share
from evaluation.play.study import make_job
from evaluation.record.manifest import write_run
from zoo.locations import cache_root
from zoo.registry import Registry
from zoo.schema import PolicyEntry
from zoo.transport.fetch import check_local

Shown = bool | Callable[[Progress], None]
Globs = str | Sequence[str] | None


def evaluate(
    robot: Any,
    *,
    task: str | None = None,
    split: str | None = None,
    partners: str | Sequence[str] | None = None,
    persons: int | None = None,
    episodes: int | None = None,
    seed: int = 0,
    backend: str = "auto",
    stochastic: bool = False,
    max_envs: int | None = None,
    preferences: str | Sequence[str] | None = None,
    series: int = 1,
    metrics: str | Sequence[str] | None = None,
    include_own: bool = False,
    trained_with: str | Sequence[str] | None = None,
    references: bool = True,
    crossplay: "Path | CrossPlayResult | None" = None,
    reuse: bool = False,
    replace: bool = False,
    fetch: bool = False,
    zoo: "str | Path | Zoo | None" = None,
    lock: Path | str | None = None,
    out: Path | str | None = None,
    progress: Shown = True,
) -> EvaluationResult:
    """Compute M_test: the return of a robot with partners that it never met.

    Each partner plays under its own disability setting, in its own episodes, which are the same for
    every robot.

    Args:
        robot: A callable from observations [N, O] to actions [N, A], float32, called with one row
            for each episode; an object with `act(obs)` and `reset(n)`; a model with
            Stable-Baselines3's `predict`; a PyTorch module; a Flax module with parameters,
            `(module, params)`; a `Partner` in the robot's role; a path of a .safetensors or .onnx
            file; an id; or "python:mod.py:make". A list of them are seeds of one method. Networks
            play in evaluation mode, and come back as they were.
        task: Task, such as scratch. Default: that of the names.
        split: Sides of a split whose partners play: test (default), train or both sides of the
            default split, or the id of another split (ID:both). Persons and splits of three sides
            have validation too.
        partners: Glob over partners, or several, such as `'scratch/ippo-d9-*'`: only matching
            partners of those sides play. If all of them are of one release, its default split is
            meant. persons for persons, or a glob such as `'gentle_scratch/person-08*'`; teams may
            be named beside them.
        persons: Number of persons to draw. Default 200.
        episodes: Episodes of each pair. Default 18 in the gentle tasks, where nine preferences take
            turns, 4 with persons, and 8 in the other tasks.
        seed: Seed of the episodes. Each partner has its own episodes, the same for every robot.
        backend: Physics: fused, native, mjx, mjx-warp, or auto for the fastest one here.
        stochastic: Draw actions instead of taking each policy's most likely one.
        max_envs: Most simulations in a saved part, and on a GPU at once. Lower it if memory runs
            out.
        preferences: Preferences of a gentle task's humans, such as p1,p5. Each partner takes turns
            in them from episode to episode. Default: those of the partner's side of the split, or
            all if the split holds none out.
        series: Episodes that a robot plays with a partner before it forgets. Its recurrent state is
            kept through a series, and the partner's preference stays. The result then says how the
            return grows within a series.
        metrics: Metrics that installed packages add, such as a,b. The figures have them under
            "more", and episodes have the columns that the metrics need.
        include_own: Count partners that were trained with one of the robots. Without this they play
            and stand in the tables, and figures leave them out.
        trained_with: Training partners of the robots, if neither the zoo nor the robots' files name
            them: nobody, or one or several of split ids, each for its training side, and globs over
            partners.
        references: Compare with zero and random actions, the task's script and each partner's own
            robot, and play with a human that does nothing. Their results are kept for later
            evaluations.
        crossplay: Finished cross-play, whose best robots may be the partners' best responses.
        reuse: Take the result in the output folder of a robot from Python code, even if its module
            does not declare its dependencies. Without this the result is refused, since the robot
            may have changed.
        replace: Remove the result in the output folder, of whichever job, and play anew. Without
            this the result of another job is refused.
        fetch: Fetch partners and robots of the zoo that are missing here from the remote.
        zoo: Source of partners and ids, as in `open_zoo`.
        lock: Lock file of a paper. Bytes and splits other than the pinned ones are refused.
        out: Folder for the tables. A stopped run continues there. Default: a temporary folder,
            which lives as long as the result.
        progress: Show the progress, or a function that is called with it.

    Raises:
        ValueError: A named thing does not exist, or does not fit the task.
        TypeError: `robot` has another type.
        EgoError: The robot failed. The error names the partner, the step and the fault.
        ZooError: The zoo lacks a policy, or has changed bytes of it.

    Examples:
        >>> import numpy as np
        >>> still = lambda obs: np.zeros((len(obs), 7))
        >>> near = "scratch/ippo-d1-s[01]"
        >>> result = evaluate(still, task="scratch", split="both", partners=near, episodes=1,
        ...                   references=False, progress=False)
        >>> result.episodes.height
        2
    """
    robots = list(robot) if isinstance(robot, list) else [robot]
    task = task or task_of(robots)
    names = _text(preferences)
    played = episodes, seed, backend, stochastic, max_envs, names, series, _text(metrics)
    how = PlaySettings(task, *played)
    opened = _locked(open_zoo(zoo), lock, task, split)
    chosen = choose_partners(opened.registry, task, split, partners or None, persons)
    needed = _needed(opened.registry, robots, chosen[1], references)
    if fetch:
        opened.fetch([entry.id for entry in needed])
    else:
        check_local(opened.registry, needed)
    kept, (folder, keep) = cache_root() / "references", _folder(out)
    with _no_empty_folder(folder):
        cast = cast_robots(
            opened.registry,
            robots,
            chosen,
            trained_with=trained_with or None,
            baselines=references,
            default=leaves_the_choice(split, partners),
        )
    with chosen_progress(progress, StudyLine(f"evaluate {task}")) as on_progress:
        summary = evaluate_cast(
            cast,
            how,
            folder,
            include_own=include_own,
            references=kept if references else None,
            crossplay=crossplay.folder if isinstance(crossplay, CrossPlayResult) else crossplay,
            reuse=reuse,
            replace=replace,
            on_progress=on_progress,
        )
    write_run(folder, command_line(), simulated=summary.env_steps_per_second is not None)
    return EvaluationResult.of(summary, folder, keep)


def cross_play(
    robots: str | Sequence[str] | None = None,
    humans: str | Sequence[str] | None = None,
    *,
    task: str | None = None,
    release: str | None = None,
    persons: int | None = None,
    episodes: int | None = None,
    seed: int = 0,
    backend: str = "auto",
    stochastic: bool = False,
    max_envs: int | None = None,
    preferences: str | Sequence[str] | None = None,
    metrics: str | Sequence[str] | None = None,
    zoo: "str | Path | Zoo | None" = None,
    lock: Path | str | None = None,
    out: Path | str | None = None,
    replace: bool = False,
    cluster: RayCluster | None = None,
    progress: Shown = True,
) -> CrossPlayResult:
    """Play every robot with every human, and cluster the matrix, whose diagonal is self-play.

    Args:
        robots: Globs over robots, such as "scratch/ippo-*"; all of the task if None.
        humans: Globs over humans, or "persons"; all of the task if None.
        task: Task, such as scratch. Default: that of the names.
        release: Release of robots and humans, if a glob names none. Default: the newest complete
            release that has the task.
        persons: Number of persons to draw. Default 200.
        episodes: Episodes of each pair. Default 18 in the gentle tasks, where nine preferences take
            turns, 4 with persons, and 8 in the other tasks.
        seed: Seed of the episodes. Each partner has its own episodes, the same for every robot.
        backend: Physics: fused, native, mjx, mjx-warp, or auto for the fastest one here.
        stochastic: Draw actions instead of taking each policy's most likely one.
        max_envs: Most simulations in a saved part, and on a GPU at once. Lower it if memory runs
            out.
        preferences: Preferences of a gentle task's humans, such as p1,p5. Each partner takes turns
            in them from episode to episode. Default: those of the partner's side of the split, or
            all if the split holds none out.
        metrics: Metrics that installed packages add, such as a,b. The figures have them under
            "more", and episodes have the columns that the metrics need.
        zoo: Source of the policies, as in `open_zoo`.
        lock: Lock file of a paper. Bytes other than the pinned ones are refused.
        out: As in `evaluate`.
        replace: Remove the result in the output folder, of whichever job, and play anew. Without
            this the result of another job is refused.
        cluster: Ray cluster that plays the blocks. Its workers need the folder `out` too.
        progress: Show the progress, or a function that is called with it.

    Raises:
        ValueError: A named thing does not exist, or does not fit the task.
        ZooError: The zoo lacks a policy, or has changed bytes of it.

    Examples:
        >>> team = "scratch/ippo-d1-s0"
        >>> cross_play(team, team, episodes=1, progress=False).pairs.height
        1
    """
    names: dict[str, Any] = {"preferences": _text(preferences), "metrics": _text(metrics)}
    task = task or task_of([*_listed(robots), *_listed(humans)])
    how = PlaySettings(task, episodes, seed, backend, stochastic, max_envs, **names)
    opened = open_zoo(zoo)  # a zoo that is refused makes no folder
    folder, keep = _folder(out)
    with _no_empty_folder(folder):
        cast = _population(robots, humans, task, release, opened, lock, persons)
    options: dict[str, Any] = {"cluster": cluster, "replace": replace}
    with chosen_progress(progress, StudyLine(f"crossplay {task}")) as on_progress:
        summary = play_population(cast, how, folder, on_progress=on_progress, **options)
    write_run(folder, command_line(), simulated=summary.env_steps_per_second is not None)
    return CrossPlayResult.of(summary, folder, keep)


def play_share(
    share: tuple[int, int],
    how: PlaySettings,
    out: Path,
    robots: Globs = None,
    humans: Globs = None,
    *,
    release: str | None = None,
    persons: int | None = None,
    zoo: "str | Path | Zoo | None" = None,
    lock: Path | str | None = None,
    progress: Shown = True,
) -> ShareDone:
    """Simulate share (i, n) of a cross-play, i from 1; with all of them `cross_play` merges them.

    Args:
        share: Number of the share, and the count of shares.
        how: Settings of the play.
        out: Folder of the parts.
        robots: As in `cross_play`, like all that follows.
        humans: Globs over humans.
        release: Release of both.
        persons: Number of persons to draw.
        zoo: Source of the policies.
        lock: Lock file of a paper.
        progress: Show the progress, or a function that is called with it.
    """
    cast = _population(robots, humans, how.task, release, zoo, lock, persons)
    env, job = make_job(how, cast.robots, cast.humans, cast.sides, cast.version)
    with chosen_progress(progress, StudyLine(f"crossplay {how.task}")) as shown:
        return run_share(env, job, out, share, max_envs=how.max_envs, on_progress=shown)


def _population(
    robots: Globs,
    humans: Globs,
    task: str,
    release: str | None,
    zoo: "str | Path | Zoo | None",
    lock: Path | str | None,
    persons: int | None,
) -> Cast:
    """Return the cast of a cross-play; without globs it has all teams of the task."""
    registry = _locked(open_zoo(zoo), lock, task, None).registry
    return cast_population(registry, task, robots or f"{task}/*", humans, release, persons)


def _needed(
    registry: Registry, robots: Sequence[Any], partners: Sequence[PolicyEntry], references: bool
) -> list[PolicyEntry]:
    """Return the policies that an evaluation loads: partners, robots of the zoo, references."""
    ids = {entry.id for entry in partners}
    named = [parse_reference(str(robot)) for robot in robots if isinstance(robot, str | Path)]
    wanted = (registry.full(r.source) for r in named if r.kind == "zoo")
    ids |= {f"{name.removesuffix('/robot')}/robot" for name in wanted}
    ids |= {f"{entry.team}/robot" for entry in partners} if references else set()
    return [entry for entry in registry.policies if entry.id in ids]


def _listed(globs: Globs) -> list[str]:
    return [globs] if isinstance(globs, str) else list(globs or ())


def _text(names: str | Sequence[str] | None) -> str | None:
    """Return names, such as those of preferences, as they are typed: "p1,p5"."""
    return names if names is None or isinstance(names, str) else ",".join(names)


def _locked(zoo: Zoo, lock: Path | str | None, task: str, split: str | None) -> Zoo:
    if lock is None:
        return zoo
    from zoo.lock import apply_lock, read_lock

    return Zoo(apply_lock(zoo.registry, read_lock(Path(lock)), task=task, split=split), zoo.remote)


@contextlib.contextmanager
def _no_empty_folder(folder: Path) -> Generator[None]:
    """Remove an output folder that is still empty if the block in it fails."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):  # it is not empty
            folder.rmdir()
        raise


def _folder(out: Path | str | None) -> tuple[Path, Any]:
    """Return the output folder, and an owner that must live as long as the folder is used."""
    if out is not None:
        check_folder(Path(out))  # before anything is loaded
        return Path(out), None
    folder = TemporaryFolder()
    return folder.path, folder
