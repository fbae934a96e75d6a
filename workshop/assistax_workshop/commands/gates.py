"""Training for the gates of tasks: teams for an audit, robots with persons."""

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
        folder: Folder of the runs.
        only: Conditions, comma-separated; all if not given.
        seeds: Seeds of each condition: how many, or which, such as 8 or 100-107.
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


def persons(
    task: str,
    folder: Path,
    /,
    *,
    only: str = "",
    seeds: str = "8",
    steps: str = "",
    single: int = 50,
    tries: int = 400,
    models: int = 32,
    programs: int = 256,
    set_: Changes = (),
    backend: str = "auto",
    json: bool = False,
) -> None:
    """Train robots with persons, play them with strangers, and print the gates of persons.

    Robots are ppo, gru, rma, osi, told-gru, masked (persons show nothing), dagger (imitates
    told-gru), learned (dagger with the test side), idle and best (one a person). Others are script,
    told-script, search and search-told, read, swapped (one wish changes), words (what robots do
    after them) and steals. The table covers all files in FOLDER.

    Args:
        task: Gentle task.
        folder: Folder of runs and results.
        only: Stages, comma-separated, or "table" for none; all if not given.
        seeds: Robots of each kind.
        steps: Environment steps of each robot; if not given, 50M, of dagger and best responses 20M.
        single: Persons with a best response.
        tries: Tries of each search.
        models: Persons of each try.
        programs: Open-loop programs that are tried.
        set_: Hyperparameter, such as num_envs=512; repeat it for more.
        backend: fused, native, mjx, mjx-warp, or auto for the fastest here.
        json: Print the gates as JSON.

    Example:
        assistax-zoo gates persons gentle_bath runs/persons-bath --only read
    """
    from assistax_workshop.commands.audit import print_gates
    from assistax_workshop.gates.persons.play import Plan
    from assistax_workshop.gates.persons.stages import STAGES, run_stages
    from assistax_workshop.gates.persons.table import gates_of_persons, read_stages
    from assistax_zoo.shell.console import print_json, stdout_is_data
    from evaluation.record.tables import to_json

    plan = Plan(
        task,
        folder,
        parse_seeds(seeds),
        parse_steps(steps) if steps else None,
        *(single, tries, models, programs),
        changes=parse_changes(set_),
        backend=backend,
    )
    with stdout_is_data():
        run_stages(plan, [name for name in parse_names(only) or STAGES if name != "table"])
        gates = to_json(gates_of_persons(task, read_stages(folder)))
    print_json(gates) if json else print_gates(f"{task}, persons", gates, told=True)
