"""Command that searches hyperparameters."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from assistax_base.errors import counted
from assistax_zoo.commands.options import Engine, parse_changes, parse_steps
from assistax_zoo.shell.console import answer, progress, stdout_is_data

if TYPE_CHECKING:
    from assistax_workshop.sweep import Sweep


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Search:
    """Configurations of a sweep.

    Attributes:
        space: JSON file, by hyperparameter a range {"low", "high", "log"} or a list of values;
            default a built-in one.
        configurations: Number of configurations.
        seeds: Seeds of each.
        disability: Setting of the human, such as d1.
        steps: Environment steps of each configuration and seed, such as 2M.
        block: Most configurations x seeds in one program; lower it if memory runs out.
        seed: Seed of the random draws.
        set_: A hyperparameter that all configurations share, such as num_envs=512; repeat it for
            more.
    """

    space: Path | None = None
    configurations: int = 168
    seeds: int = 3
    disability: str = "d1"
    steps: str = "2M"
    block: int = 64
    seed: int = 0
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = ()

    def sweep(self, task: str, algorithm: str) -> "Sweep":
        """Return the sweep of a task and an algorithm."""
        from assistax_workshop.sweep import make_sweep

        return make_sweep(
            task,
            algorithm,
            space=self.space,
            configurations=self.configurations,
            seeds=self.seeds,
            disability=self.disability,
            steps=parse_steps(self.steps),
            block=self.block,
            seed=self.seed,
            fixed=parse_changes(self.set_),
        )


def sweep(
    *,
    task: str,
    out: Path,
    algorithm: str = "ippo",
    search: Search = Search(),
    backend: str = "auto",
    engine: Engine = Engine(),
    json: bool = False,
) -> None:
    """Try hyperparameters, many at once in one program.

    Continuous ones are drawn at random, discrete ones form a grid. The same command again continues
    an interrupted sweep. The best configuration is written as preset.json, which `assistax-zoo
    train --preset` reads.

    Args:
        task: Task, such as scratch.
        out: Folder of the sweep: a run for each block, sweep.parquet, preset.json.
        algorithm: Preset that is varied: ippo, mappo, isac, masac or mep.
        search: Configurations of the sweep.
        backend: Physics: fused, native, mjx, mjx-warp, or auto for the fastest one.
        engine: Machines that run the blocks.
        json: Print the results as JSON.

    Example:
        assistax-zoo sweep --task scratch --algorithm ippo --configurations 168 --seeds 3 --out
        sweeps/ippo
    """
    cluster = engine.cluster()
    with stdout_is_data():
        from assistax_workshop.sweep import BEST, RESULTS, sweep_task

        plan = search.sweep(task, algorithm)
        with progress(f"sweep {task} {algorithm}, environment steps", plan.total_steps) as advance:
            results, best = sweep_task(plan, out, backend, cluster, advance)
    diverged = results.filter(results["diverged"]).height
    answer(
        json,
        {
            "best": {"algorithm": algorithm, "hyperparameters": best},
            "results": results.to_dicts(),
        },
        f"{counted(plan.configurations, 'configuration')} x {counted(plan.seeds, 'seed')}, "
        f"{counted(diverged, 'run')} diverged; {out / RESULTS} has every one",
        f"best: {', '.join(f'{name}={value}' for name, value in best.items())}",
        f"next: assistax-zoo train --task {task} --preset {out / BEST} --out "
        f"runs/{task}-{algorithm}",
    )
