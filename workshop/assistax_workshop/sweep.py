"""Hyperparameter sweeps: many configurations side by side, as members of a few vmapped programs.

Continuous hyperparameters are traced: configurations that differ in them alone share one compiled
program. Discrete ones change the program, so each combination of them has one or more blocks.
"""

import dataclasses
import itertools
import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pydantic import PositiveInt

from assistax_base.cluster import NOT_SHARED, RayCluster, run_blocks
from assistax_base.files import write_json
from assistax_base.parquet import read_parquet, write_parquet
from assistax_base.validated import validated
from assistax_workshop.sweep_space import SPACES, Range, Space, read_space
from population.config import Member, TrainConfig, check_names, make_run
from population.environment import Environment
from population.hyperparameters import preset
from population.runs.train import Progress, train

RESULTS, BEST = "sweep.parquet", "preset.json"
FINAL_SHARE = 0.1  # of a run: the final return is the mean over its last tenth


@validated
class Sweep:
    """Settings of a sweep."""

    task: str  # environment task
    algorithm: str  # preset that is varied
    space: Space  # hyperparameters by name
    configurations: PositiveInt = 168  # number of points
    seeds: PositiveInt = 3  # seeds of each point
    disability: str = "d1"  # the human's setting
    steps: PositiveInt = 2_000_000  # environment steps of each member
    block: PositiveInt = 64  # most members in one program
    seed: int = 0  # draws the points
    # Other changes of the preset.
    fixed: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.block < self.seeds:
            raise ValueError(
                f"block is {self.block}; it must hold the {self.seeds} seeds of a configuration"
            )
        traced = preset(self.algorithm, **self.fixed).traced
        for name, values in self.space.items():
            if isinstance(values, Range) and name not in traced:
                raise ValueError(
                    f"{name} has a range; ranges are for {', '.join(traced)}: give a list of values"
                )
        for point in itertools.product(*self._discrete().values()):
            preset(
                self.algorithm, **{**self.fixed, **dict(zip(self._discrete(), point, strict=True))}
            )

    @property
    def total_steps(self) -> int:
        """Environment steps of all configurations and seeds."""
        return self.configurations * self.seeds * self.steps

    def block_steps(self, number: int) -> int:
        """Environment steps of one block."""
        return len(self.blocks()[number][0]) * self.seeds * self.steps

    def points(self) -> list[dict[str, Any]]:
        """Return the configurations, each a dict of hyperparameters.

        The grid over discrete values in turn, random draws of the others.
        """
        rng = np.random.default_rng(self.seed)
        grid = list(itertools.product(*self._discrete().values()))
        return [
            dict(zip(self._discrete(), grid[index % len(grid)], strict=True))
            | {
                name: values.draw(rng)
                for name, values in self.space.items()
                if isinstance(values, Range)
            }
            for index in range(self.configurations)
        ]

    def blocks(self) -> list[tuple[list[int], TrainConfig]]:
        """Return the sweep's blocks: indices of configurations, and the run that trains them."""
        points, discrete = self.points(), self._discrete()
        groups: dict[tuple[Any, ...], list[int]] = {}
        for index, point in enumerate(points):
            groups.setdefault(tuple(point[name] for name in discrete), []).append(index)
        size = self.block // self.seeds
        return [
            (
                part,
                self._run(
                    dict(zip(discrete, values, strict=True)), [points[index] for index in part]
                ),
            )
            for values, indices in groups.items()
            for part in (indices[start : start + size] for start in range(0, len(indices), size))
        ]

    def _run(self, discrete: dict[str, Any], points: list[dict[str, Any]]) -> TrainConfig:
        """Return the run of a block's configurations and seeds."""
        members = tuple(
            Member(
                seed,
                self.disability,
                {name: value for name, value in point.items() if name not in discrete},
            )
            for point in points
            for seed in range(self.seeds)
        )
        trainer = preset(self.algorithm, **{**self.fixed, **discrete})
        return make_run(
            self.task, self.algorithm, members, self.steps, trainer, self_play_episodes=0
        )

    def _discrete(self) -> dict[str, tuple[Any, ...]]:
        """Return the discrete hyperparameters and their values."""
        return {
            name: values for name, values in self.space.items() if not isinstance(values, Range)
        }


def make_sweep(task: str, algorithm: str, space: Path | None = None, **fields: Any) -> Sweep:
    """Return a sweep over the space of a JSON file, or over the trainer's built-in one.

    Raises:
        ValueError: Task, setting, algorithm or space are not allowed.
    """
    check_names(task, [fields["disability"]] if "disability" in fields else [])
    kind = preset(algorithm, **fields.get("fixed", {})).kind
    return Sweep(task, algorithm, SPACES[kind] if space is None else read_space(space), **fields)


def sweep_task(
    sweep: Sweep,
    folder: Path,
    backend: str = "auto",
    cluster: RayCluster | None = None,
    advance: Callable[[int], None] = lambda steps: None,
) -> tuple[pl.DataFrame, dict[str, Any]]:
    """Run a sweep on a backend; return its rows, and the best hyperparameters."""
    from assistax_envs import make

    results = run_sweep(sweep, partial(make, sweep.task, backend), folder, cluster, advance)
    return results, json.loads((folder / BEST).read_text())["hyperparameters"]


def run_sweep(
    sweep: Sweep,
    make_env: Callable[[], Environment],
    folder: Path,
    cluster: RayCluster | None = None,
    advance: Callable[[int], None] = lambda steps: None,
) -> pl.DataFrame:
    """Train every configuration, block by block; return a row for each configuration and seed.

    The folder holds a run for each block, `sweep.parquet`, and the best configuration as
    `preset.json`. An interrupted sweep resumes. A configuration that diverges has no final return;
    the others of its block are untouched.

    Args:
        sweep: Settings of the sweep.
        make_env: Makes the environment of the task, on each worker.
        folder: Folder of the results; with a cluster all machines share it, under the same path.
        cluster: Cluster that runs the blocks, if not this machine; the table is the same.
        advance: Called with the environment steps that were done since it was last called.

    Raises:
        BlocksFailedError: Blocks failed; the others' runs are kept.
    """
    names = [_block(number) for number in range(len(sweep.blocks()))]
    if cluster is None:
        env = make_env()
        for number in range(len(names)):
            _train_block(sweep, number, env, folder, advance)
        return _collect(sweep, folder)
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    run_blocks(
        cluster,
        lambda _: names,
        _train_remotely,
        (sweep, make_env, folder),
        lambda number: advance(sweep.block_steps(number)),
    )
    if missing := [name for name in names if not (folder / name).exists()]:
        raise ValueError(
            f"the workers are done, but {folder} lacks {', '.join(missing)} here; {NOT_SHARED}"
        )
    return _collect(sweep, folder)


def _train_remotely(
    number: int, _: int, sweep: Sweep, make_env: Callable[[], Environment], folder: Path
) -> None:
    """Train a block on a worker."""
    _train_block(sweep, number, make_env(), folder)


def _train_block(
    sweep: Sweep,
    number: int,
    env: Environment,
    folder: Path,
    advance: Callable[[int], None] = lambda steps: None,
) -> None:
    """Train a block, or find it finished."""
    _, config = sweep.blocks()[number]
    size, shown = sweep.block_steps(number), 0

    def report(progress: Progress) -> None:
        nonlocal shown
        before, shown = shown, size * progress.update // progress.updates
        advance(shown - before)

    train(config, env, folder / _block(number), stop_on_divergence=False, progress=report)
    advance(size - shown)  # the rest, for a block that was finished before


def _collect(sweep: Sweep, folder: Path) -> pl.DataFrame:
    """Write and return the results of all blocks."""
    points, tables = sweep.points(), []
    for number, (indices, _) in enumerate(sweep.blocks()):
        scores = score(read_parquet(folder / _block(number) / "metrics.parquet"))
        rows = [
            {"configuration": index, "seed": seed, **points[index]}
            for index in indices
            for seed in range(sweep.seeds)
        ]
        tables.append(
            pl.DataFrame(rows).with_columns(
                scores["final_return"], scores["auc"], scores["diverged"]
            )
        )
    results = pl.concat(tables).sort("configuration", "seed")
    write_parquet(results, folder / RESULTS)
    content = {
        "algorithm": sweep.algorithm,
        "hyperparameters": {**sweep.fixed, **best(results, points)},
    }
    write_json(folder / BEST, content)
    return results


def score(metrics: pl.DataFrame) -> pl.DataFrame:
    """Return final_return, auc and diverged of each member of a run, in order.

    The final return is the mean of the episodes that ended in the last tenth of the steps; `auc` is
    the mean over all updates, so that the area under the curve is in units of return. A member with
    a loss that is not finite has none.
    """
    losses = [name for name in metrics.columns if "loss" in name]
    last = pl.col("steps") > (1.0 - FINAL_SHARE) * pl.col("steps").max()
    episodes, returns = pl.col("episodes"), pl.col("return")
    table = metrics.group_by("member", maintain_order=True).agg(
        ((returns * episodes).filter(last).sum() / episodes.filter(last).sum()).alias(
            "final_return"
        ),
        returns.mean().alias("auc"),
        pl.any_horizontal(~pl.col(name).is_finite().all() for name in losses).alias("diverged"),
    )
    gone = pl.col("diverged")
    return table.sort("member").with_columns(
        pl.when(gone).then(None).otherwise(pl.col(name)).fill_nan(None).alias(name)
        for name in ("final_return", "auc")
    )


def best(results: pl.DataFrame, points: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the configuration with the highest mean final return over seeds.

    Configurations with a diverged seed are left out.

    Raises:
        ValueError: No configuration has a final return for every seed.
    """
    means = results.group_by("configuration").agg(
        pl.col("final_return").mean().alias("mean"),
        pl.col("final_return").null_count().alias("missing"),
    )
    whole = means.filter(pl.col("missing") == 0).sort(
        "mean", "configuration", descending=[True, False]
    )
    if whole.is_empty():
        raise ValueError(
            "no configuration finished an episode with every seed; give more steps or a narrower "
            "space"
        )
    return points[whole["configuration"][0]]


def _block(number: int) -> str:
    """Return the name of a block and its folder."""
    return f"block-{number:03d}"
