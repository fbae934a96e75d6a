"""The command that searches hyperparameters."""

import json as jsonlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from assistax_zoo.commands.options import Engine
from assistax_zoo.commands.train import parse_changes, parse_steps
from assistax_zoo.console import print_json, progress, stdout_is_data

if TYPE_CHECKING:
    from population.train import Progress


def sweep(
    *,
    task: str,
    out: Path,
    algorithm: str = "ippo",
    space: Path | None = None,
    configurations: int = 168,
    seeds: int = 3,
    disability: str = "d1",
    steps: str = "2M",
    block: int = 64,
    seed: int = 0,
    backend: str = "auto",
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    engine: Engine = Engine(),
    json: bool = False,
) -> None:
    """Try hyperparameters.

    Random over continuous ones, a grid over discrete ones, many at once in one program.

    The same command again goes on where a sweep was interrupted. The best configuration is written
    as preset.json, which `assistax-zoo train --preset` reads.

    Args:
        task: Task, such as scratch.
        out: Folder of the sweep: a run for each block, sweep.parquet, preset.json.
        algorithm: Preset that is varied: ippo, mappo, isac or masac.
        space: JSON file, by hyperparameter a range {"low", "high", "log"} or a list of values;
            default a built-in one.
        configurations: Number of configurations.
        seeds: Seeds of each.
        disability: Setting of the human, such as d1.
        steps: Environment steps of each configuration and seed, such as 2M.
        block: Most configurations x seeds in one program; lower it if memory runs out.
        seed: Seed of the random draws.
        backend: Physics: native, mjx, mjx-warp, or auto for the fastest one here.
        set_: A hyperparameter that all configurations share, such as num_envs=512; repeat it for
            more.
        engine: What runs the blocks.
        json: Print the results as JSON.

    Example:
        assistax-zoo sweep --task scratch --algorithm ippo --configurations 168 --seeds 3 --out
        sweeps/ippo
    """
    from population.team_training import check_names

    check_names(task, [disability])
    total, fixed, cluster = parse_steps(steps), parse_changes(set_), engine.cluster()
    work = configurations * seeds * total
    with (
        stdout_is_data(),
        progress(f"sweep {task} {algorithm}, environment steps", work) as advance,
    ):
        from assistax_envs import make
        from population.config import preset
        from population.sweep import (
            BEST,
            RESULTS,
            SPACES,
            Sweep,
            read_space,
            run_sweep,
            run_sweep_on_ray,
        )

        chosen = (
            SPACES[preset(algorithm, **fixed).kind]
            if space is None
            else read_space(_read_object(space))
        )
        plan = Sweep(
            task, algorithm, chosen, configurations, seeds, disability, total, block, seed, fixed
        )
        if cluster is None:
            results = run_sweep(plan, make(task, backend), out, _Shown(advance, work))
        else:
            sizes = [len(members) * seeds * total for members, _ in plan.blocks()]
            results = run_sweep_on_ray(
                plan,
                partial(make, task, backend),
                out,
                cluster,
                lambda number: advance(sizes[number]),
            )
    best = jsonlib.loads((out / BEST).read_text())
    if json:
        print_json({"best": best, "results": results.to_dicts()})
        return
    diverged = results.filter(results["diverged"]).height
    print(
        f"{configurations} configurations x {seeds} seeds, {diverged} runs diverged; "
        f"{out / RESULTS} has every one"
    )
    print(
        f"best: {', '.join(f'{name}={value}' for name, value in best['hyperparameters'].items())}"
    )
    print(
        f"next: assistax-zoo train --task {task} --preset {out / BEST} --out "
        f"runs/{task}-{algorithm}"
    )


class _Shown:
    """Advances a progress bar by the share of all work that is done."""

    def __init__(self, advance: Callable[[int], None], total: int) -> None:
        self._advance, self._total, self._done = advance, total, 0

    def __call__(self, block: int, blocks: int, report: "Progress") -> None:
        done = int(self._total * (block + report.update / report.updates) / blocks)
        self._advance(done - self._done)
        self._done = done


def _read_object(path: Path) -> dict[str, Any]:
    try:
        content = jsonlib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(
            f"{path} is not JSON ({error}); give an object of hyperparameters"
        ) from None
    if not isinstance(content, dict) or not content:
        raise ValueError(
            f"{path} holds {type(content).__name__}; give an object with at least one "
            "hyperparameter"
        )
    return content
