"""Training for the gates of tasks: teams for an audit, told robots, curves."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from assistax_zoo.commands.options import parse_changes, parse_names, parse_seeds, parse_steps

GATES = "Train teams and robots for the gates of gentle tasks."
Changes = Annotated[tuple[str, ...], Parameter(name="--set", negative="")]


def train(
    task: str,
    folder: Path,
    /,
    *,
    only: str = "",
    seeds: str = "4",
    steps: str = "20M",
    disability: str = "d1",
    set_: Changes = (),
    backend: str = "auto",
) -> None:
    """Train policies for the gates of a gentle task, each condition into FOLDER/CONDITION.

    Interrupted runs continue. Conditions with humans of teams need FOLDER/teams first.

    Args:
        task: Gentle task.
        folder: Of the runs.
        only: Conditions, comma-separated; all if not given.
        seeds: Of each condition: how many, or which, such as 8 or 100-107.
        steps: Environment steps of each team.
        disability: The human's setting.
        set_: Hyperparameter, such as num_envs=512; repeat it for more.
        backend: fused, native, mjx, mjx-warp, or auto for the fastest here.

    Example:
        assistax-zoo gates train gentle_lift runs/lift --only teams,passive --steps 16M
        assistax-zoo audit gentle_lift --team runs/lift/teams --passive-robot runs/lift/passive
    """
    from assistax_workshop.gates.training import CONDITIONS, train_conditions

    train_conditions(
        task,
        folder,
        parse_names(only) or tuple(CONDITIONS),
        seeds=parse_seeds(seeds),
        steps=parse_steps(steps),
        disability=disability,
        changes=parse_changes(set_),
        backend=backend,
    )


def told_egos(
    task: str,
    folder: Path,
    /,
    *,
    split: str | None = None,
    seeds: str = "4",
    steps: str = "10M",
    episodes: int = 8,
    set_: Changes = (),
    backend: str = "auto",
    registry: Path | None = None,
) -> None:
    """Train robots that are told what their partners like, and evaluate them.

    FOLDER/training is as of `train-ego`, FOLDER/evaluation as of `evaluate --split both`; an
    interrupted command continues.

    Args:
        task: Gentle task.
        folder: Of the run and the evaluation.
        split: Split whose training half they learn with; default that of the release.
        seeds: How many, or which.
        steps: Environment steps of each robot.
        episodes: Of each pair.
        set_: Hyperparameter, such as num_envs=512; repeat it for more.
        backend: fused, native, mjx, mjx-warp, or auto for the fastest here.
        registry: Registry to read instead of the installed one.

    Example:
        assistax-zoo gates told-egos gentle_scratch runs/told --seeds 16 --set torso=gru
    """
    from assistax_workshop.gates.told_egos import train_told_egos
    from assistax_zoo.shell.console import command_line
    from zoo.registry import load_registry

    summary = train_told_egos(
        load_registry(registry),
        task,
        folder,
        command_line(),
        split=split,
        seeds=parse_seeds(seeds),
        steps=parse_steps(steps),
        episodes=episodes,
        changes=parse_changes(set_),
        backend=backend,
    )
    for side, figure in (("train", summary.m_train), ("test", summary.m_test)):
        print(f"{side}: {figure.mean:.1f}" if figure else f"{side}: nobody")


def curves(folder: Path, /, *, out: Path) -> None:
    """Draw how the teams of the gentle tasks learned.

    Args:
        folder: Of curves, as `train population --curves` writes it.
        out: Picture to write.

    Example:
        assistax-zoo gates curves docs/data/v2/curves --out docs/images/curves_gentle.png
    """
    from assistax_workshop.gates.curves import draw_curves

    draw_curves(folder, out)
    print(out)


def persons(
    task: str,
    folder: Path,
    /,
    *,
    seeds: str = "4",
    steps: str = "24M",
    num_envs: int = 2048,
    backend: str = "auto",
) -> None:
    """Train robots with persons: plain, told, or with a memory. Play them with new persons.

    FOLDER/persons.json has what each robot earns with each person that it never met.

    Args:
        task: Gentle task.
        folder: Of the result.
        seeds: Robots of each kind: how many, or which.
        steps: Environment steps of each robot.
        num_envs: Simulations of each robot, and persons that it learns with.
        backend: fused, native, mjx, mjx-warp, or auto for the fastest here.

    Example:
        assistax-zoo gates persons gentle_bath runs/persons-bath --seeds 8
    """
    from assistax_workshop.gates.persons import train_with_persons

    folder.mkdir(parents=True, exist_ok=True)
    train_with_persons(
        task,
        folder,
        seeds=parse_seeds(seeds),
        steps=parse_steps(steps),
        num_envs=num_envs,
        backend=backend,
    )
