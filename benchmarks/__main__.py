"""Command line of the benchmarks: parse, call one function, print."""

import dataclasses
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from assistax_zoo.shell.console import print_json, stdout_is_data
from benchmarks.adapters import adapters
from benchmarks.frames import frames
from benchmarks.pages import pages, service, storm
from benchmarks.timing import check_seconds


def run(arguments: Sequence[str]) -> int:
    """Run one benchmark and return its exit code: 0 done, 1 error, 2 wrong usage."""
    app = App(name="python -m benchmarks", help="Speed on this machine.")
    for command in (env, evaluate, train, adapters, fetch, pages, service, storm, picking, frames):
        app.command(command)
    try:
        app(arguments, print_error=False, exit_on_error=False, result_action="return_value")
    except CycloptsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def env(
    *,
    task: str = "all",
    backend: str = "auto",
    batch: str = "64,512,4096",
    seconds: float = 3.0,
    persons: bool = False,
    json: bool = False,
) -> None:
    """Measure environment steps per second with random actions.

    The median of three repeats; compilation is not counted. With persons each size is measured
    twice, so that one run has the price of their programs.

    Args:
        task: Task, or all.
        backend: fused, native, mjx, mjx-warp or auto; several with commas.
        batch: Numbers of simulations, with commas.
        seconds: Measuring time of each figure, about.
        persons: Also with persons in the human's seat.
        json: Print JSON.

    Example:
        python -m benchmarks env --task scratch --backend native --batch 64,512,4096
        python -m benchmarks env --task gentle_scratch --batch 512 --persons
    """
    tasks, sizes = _tasks(task), _sizes(batch, "batch")
    check_seconds(seconds)
    with stdout_is_data():
        from assistax_envs import make
        from benchmarks.simulation import measure_env

        rows = []
        for name in tasks:
            for engine in _words(backend, "backend"):
                environment = make(name, backend=engine)
                rows += [
                    dataclasses.asdict(measure_env(environment, size, seconds, met))
                    for size in sizes
                    for met in (False, True)[: 1 + persons]
                ]
    if json:
        print_json(rows)
        return
    print("open loop; median of 3 repeats, compilation not counted")
    for row in rows:
        spread = f"{min(row['repeats']):,.0f} to {max(row['repeats']):,.0f}"
        print(
            f"{row['task']:10} {row['backend']:9} {row['batch']:7,} simulations, {row['human']:7} "
            f"{row['env_steps_per_second']:12,.0f} env steps/s ({spread}; {row['steps']} steps "
            f"each; {row['device']})"
        )


def evaluate(
    *,
    task: str = "all",
    backend: str = "auto",
    shape: str = "8,16,4",
    seconds: float = 6.0,
    json: bool = False,
) -> None:
    """Measure the evaluator with untrained policies, and the raw environment in turns with it.

    Args:
        task: Task, or all.
        backend: fused, native, mjx, mjx-warp or auto.
        shape: Robots, partners and episodes of the block, with commas.
        seconds: Measuring time of each of the two, about.
        json: Print JSON.

    Example:
        python -m benchmarks evaluate --backend native --shape 8,16,4
    """
    tasks, sizes = _tasks(task), _sizes(shape, "shape")
    if len(sizes) != 3:
        raise ValueError(f"shape is {shape!r}; expected three numbers: robots,partners,episodes")
    check_seconds(seconds)
    block = sizes[0], sizes[1], sizes[2]
    with stdout_is_data():
        from assistax_envs import make
        from benchmarks.simulation import measure_evaluator

        rows = [
            dataclasses.asdict(measure_evaluator(make(name, backend=backend), block, seconds))
            for name in tasks
        ]
    if json:
        print_json(rows)
        return
    for row in rows:
        print(
            f"{row['task']} on {row['backend']} ({row['device']}), {block[0]} x {block[1]} pairs x "
            f"{block[2]} episodes"
        )
        print(
            f"  evaluator    {row['env_steps_per_second']:12,.0f} env steps/s, "
            f"{row['pairs_per_second']:.2f} pairs/s"
        )
        print(
            f"  environment  {row['raw_env_steps_per_second']:12,.0f} env steps/s with random "
            "actions"
        )
        print(f"  ratio        {row['ratio']:12.2f}")


def train(
    *,
    task: str = "scratch",
    algorithm: str = "ippo",
    backend: str = "auto",
    seeds: int = 1,
    num_envs: int | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    seconds: float = 20.0,
    json: bool = False,
) -> None:
    """Measure environment steps per second of training, and where its time goes.

    The shares are of physics, networks and updates. Whole updates, rollouts alone and physics
    alone are timed in turns; medians of three, compilation not counted.

    Args:
        task: Task.
        algorithm: ippo, mappo, isac, masac or mep.
        backend: fused, native, mjx, mjx-warp or auto.
        seeds: Teams trained side by side.
        num_envs: Simulations of each team; default the preset's.
        set_: Another hyperparameter, such as rollout_steps=32; repeat it for more.
        seconds: Measuring time, about.
        json: Print JSON.

    Example:
        python -m benchmarks train --task scratch --algorithm ippo --seeds 8
    """
    from assistax_zoo.commands.options import parse_changes
    from population.config import check_names

    check_names(task)
    check_seconds(seconds)
    if not 1 <= seeds <= 4096:
        raise ValueError(f"seeds is {seeds}; allowed is 1 to 4096")
    changes = parse_changes(set_) | ({} if num_envs is None else {"num_envs": num_envs})
    with stdout_is_data():
        from assistax_envs import make
        from benchmarks.training import measure_training
        from population.hyperparameters import preset

        config = preset(algorithm, **changes)
        row = dataclasses.asdict(
            measure_training(make(task, backend), algorithm, config, seeds, seconds)
        )
    if json:
        print_json(row)
        return
    print(
        f"{row['task']} {row['algorithm']} on {row['backend']} ({row['device']}), "
        f"{row['members']} teams x {row['num_envs']} simulations x {row['rollout_steps']} steps"
    )
    spread = f"{min(row['repeats']):,.0f} to {max(row['repeats']):,.0f}"
    print(f"  training  {row['env_steps_per_second']:12,.0f} env steps/s ({spread})")
    for name in ("physics", "networks", "updates"):
        print(f"  {name:9} {row[f'{name}_share']:12.0%} of the time")


def fetch(*, policies: int = 1000, json: bool = False) -> None:
    """Measure list, verify and fetch on a synthetic registry, served on loopback.

    Args:
        policies: Policies of the registry, which is made in a temporary folder: some 90 kB each,
            and as much in caches.
        json: Print JSON.

    Example:
        python -m benchmarks fetch --policies 1000
    """
    if not 2 <= policies <= 20_000:
        raise ValueError(f"policies is {policies}; allowed is 2 to 20000")
    with tempfile.TemporaryDirectory(prefix="assistax-zoo-") as folder:
        from benchmarks.registry import measure_zoo

        row = dataclasses.asdict(
            measure_zoo(Path(folder), policies, [sys.executable, "-m", "assistax_zoo"])
        )
    if json:
        print_json(row)
        return
    print(
        f"{row['policies']} policies in {row['shards']} shards, {row['bytes'] / 1e6:.0f} MB; whole "
        "commands, medians"
    )
    print(f"  python     {row['python_seconds']:8.2f} s, doing nothing")
    print(
        f"  list       {row['list_seconds']:8.2f} s, on a terminal "
        f"{row['list_terminal_seconds']:.2f} s"
    )
    print(f"  verify     {row['verify_seconds']:8.2f} s")
    print(
        f"  fetch      {row['fetch_seconds']:8.2f} s for all shards; "
        f"{row['fetch_mb_per_second']:.0f} MB/s at best"
    )


def picking(*, lists: int = 2000, json: bool = False) -> None:
    """Simulate labs that pick seeds or entries by their scores; nothing here is a time.

    Args:
        lists: Number of made-up lists of each case.
        json: Print JSON.

    Example:
        python -m benchmarks picking
    """
    from benchmarks.picking import SEEDS, measure_picking

    if lists < 1:
        raise ValueError(f"lists is {lists}; allowed are 1 and more")
    rows = measure_picking(lists)
    if json:
        print_json(rows)
        return
    for row in rows:
        shares = "  ".join(f"{count} seeds {row[str(count)]:6.1%}" for count in SEEDS)
        print(
            f"{row['measure']:12}  {shares}  {row['case']}{'' if row['allowed'] else ' (refused)'}"
        )


def _tasks(task: str) -> tuple[str, ...]:
    """Return the tasks of an option's value."""
    from assistax_envs.versions import TASKS

    if task != "all" and task not in TASKS:
        raise ValueError(f"task is {task!r}; allowed are all, {', '.join(TASKS)}")
    return TASKS if task == "all" else (task,)


def _words(text: str, name: str) -> list[str]:
    """Return the non-empty words of a comma-separated option."""
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words:
        raise ValueError(f"{name} is {text!r}; give at least one value")
    return words


def _sizes(text: str, name: str) -> list[int]:
    """Return the positive whole numbers of a comma-separated option."""
    words = _words(text, name)
    if not all(word.isdecimal() and int(word) > 0 for word in words):
        raise ValueError(
            f"{name} is {text!r}; expected whole numbers of at least 1 with commas, such as 64,512"
        )
    return [int(word) for word in words]


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
