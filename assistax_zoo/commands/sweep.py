"""The command that searches hyperparameters."""

from pathlib import Path

from assistax_zoo.commands.options import Engine, Search
from assistax_zoo.console import answer, progress, stdout_is_data


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

    Continuous ones are drawn at random, discrete ones form a grid. The same command again goes on
    where a sweep was interrupted. The best configuration is written as preset.json, which
    `assistax-zoo train --preset` reads.

    Args:
        task: Task, such as scratch.
        out: Folder of the sweep: a run for each block, sweep.parquet, preset.json.
        algorithm: Preset that is varied: ippo, mappo, isac, masac or mep.
        search: What is tried.
        backend: Physics: fused, native, mjx, mjx-warp, or auto for the fastest one.
        engine: What runs the blocks.
        json: Print the results as JSON.

    Example:
        assistax-zoo sweep --task scratch --algorithm ippo --configurations 168 --seeds 3 --out
        sweeps/ippo
    """
    cluster = engine.cluster()
    with stdout_is_data():
        from population.sweep import BEST, RESULTS, sweep_task

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
        f"{plan.configurations} configurations x {plan.seeds} seeds, {diverged} runs diverged; "
        f"{out / RESULTS} has every one",
        f"best: {', '.join(f'{name}={value}' for name, value in best.items())}",
        f"next: assistax-zoo train --task {task} --preset {out / BEST} --out "
        f"runs/{task}-{algorithm}",
    )
