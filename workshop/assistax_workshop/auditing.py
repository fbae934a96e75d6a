"""Audit of a task: whether it needs the partner, and whether it is done gently."""

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from assistax_workshop.gates.audit import EPISODES, Audit, Others, audit_task
from assistax_workshop.gates.audit_teams import Teams, read_robots, read_teams, read_trained_egos
from assistax_zoo.evaluating import Shown
from assistax_zoo.shell.console import StudyLine, chosen_progress
from assistax_zoo.zoos import Zoo, open_zoo
from evaluation.cast.cast import env_version as version_together
from evaluation.play.how import PlaySettings
from zoo.registry import Registry

Names = str | Sequence[str]


def audit(
    task: str,
    teams: Names,
    *,
    passive_robot: Names = (),
    response: Names = (),
    told: Names = (),
    blind: Names = (),
    recurrent: Names = (),
    ego: Names = (),
    ego_told: Names = (),
    ego_recurrent: Names = (),
    episodes: int = EPISODES,
    seed: int = 0,
    backend: str = "auto",
    env_version: int | None = None,
    zoo: str | Path | Zoo | None = None,
    out: Path | str | None = None,
    progress: Shown = True,
) -> Audit:
    """Return the gates of a task, measured on trained teams; gates without data are named.

    Args:
        task: Task, such as "gentle_scratch".
        teams: Folders that `train` filled, or globs over teams of the zoo: several seeds.
        passive_robot: Robots trained with an idle human: folders, or any form.
        response: Robots, one for each team, trained with its frozen human.
        told: Teams whose robot is told the human's preference.
        blind: Teams whose human is not.
        recurrent: Teams whose robot has a memory.
        ego: Robots trained with frozen humans of some teams; they play with the others'.
        ego_told: The same, told the preference.
        ego_recurrent: The same, with a memory.
        episodes: Episodes of each pair, two or more.
        seed: Seed of the episodes.
        backend: Physics: "auto" for the fastest one here, or its name.
        env_version: Version of the environment; default that of published teams, else the newest.
        zoo: Source of teams, as in `open_zoo`.
        out: Folder for the episodes, in which an interrupted audit resumes.
        progress: Whether to show progress, or a function that receives it.

    Raises:
        ValueError: An argument does not exist or does not fit the task.
        ZooError: A folder or the zoo lacks a policy, or has it changed.

    Examples:
        >>> table = audit("scratch", "scratch/ippo-d1-s[01]-v1", episodes=2, progress=False)
        >>> table.teams
        ('scratch/ippo-d1-s0-v1/robot', 'scratch/ippo-d1-s1-v1/robot')
    """
    PlaySettings(task, episodes, seed, backend)  # refuses what is none of them
    registry = open_zoo(zoo).registry
    own = read_teams(_listed(teams), registry, task)
    robots = partial(_read, read_robots, registry, task)
    pairs = partial(_read, read_teams, registry, task)
    egos = partial(_read, read_trained_egos, registry, task)
    policies = {
        **robots(passive=passive_robot, response=response),
        **pairs(told=told, blind=blind, recurrent=recurrent),
        **egos(ego=ego, ego_told=ego_told, ego_recurrent=ego_recurrent),
    }
    if env_version is None:
        env_version = version_together(registry, task, registry.known(own.robots.ids))
    play = partial(audit_task, episodes=episodes, seed=seed, backend=backend, version=env_version)
    shown = chosen_progress(progress, StudyLine(f"audit {task}"))
    with tempfile.TemporaryDirectory() as temporary, shown as on_progress:
        return play(task, own, Others(**policies), Path(out or temporary), on_progress=on_progress)


def _read(
    read: Callable[..., Teams], registry: Registry, task: str, /, **named: Names
) -> dict[str, Teams]:
    """Return the policies of each non-empty argument by name."""
    return {name: read(_listed(names), registry, task) for name, names in named.items() if names}


def _listed(names: Names) -> list[str]:
    """Return names as a list."""
    return [names] if isinstance(names, str) else list(names)
