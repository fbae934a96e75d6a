"""Measure the differences of published teams' episodes between two kinds of processor.

The same episodes are played in two processes: one computes as this processor does, the other
without fused multiply-adds, which rounds as other processors do. The figures that `replay` needs
are written to `evaluation/replay_noise.json`: `python -m tools.replay_noise scratch bed_bath`.
"""

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from cyclopts import App

from assistax_base.files import atomic_write
from assistax_base.parquet import read_parquet
from evaluation.figures.normalised import RANDOM
from evaluation.replay.noise import FILE, QUANTILES, groups_of, measured_columns, signed_gaps, wild

EPISODES = 8  # of a pair; of random actions as many with each human as of all robots
OTHER = "--xla_cpu_max_isa=AVX"  # an x86 without fused multiply-adds and with half the vectors


def measure(
    tasks: tuple[str, ...], /, *, backends: tuple[str, ...] = ("fused", "native"), teams: int = 16
) -> None:
    """Measure tasks, and write the largest figure of all backends.

    Args:
        tasks: Tasks, such as scratch.
        backends: Physics, one after the other.
        teams: Robots, and as many humans, spread over the task's release.
    """
    for task in tasks:
        played = [_play_twice(task, backend, teams) for backend in backends]
        is_random = pl.col("ego") == RANDOM
        for key, rows, by in ((task, ~is_random, "ego"), (wild(task), is_random, "partner")):
            parts = [[table.filter(rows) for table in tables] for tables in played]
            add(key, [measure_noise(*tables, by) for tables in parts])


def measure_noise(
    first: pl.DataFrame, second: pl.DataFrame, by: str = "ego"
) -> dict[str, dict[str, Any]]:
    """Return the differences of two plays of the same episodes, by column.

    Each figure is that of the robot with the largest, or of the partner if there is one robot.
    """
    measured = {}
    for name in measured_columns(first):
        gaps = np.abs(signed_gaps(first, second, name))
        groups = [gaps[rows] for _, rows in groups_of(first, [by])]
        measured[name] = {
            "quantiles": [_upper(max(np.quantile(gap, q) for gap in groups)) for q in QUANTILES],
            "rms": _upper(max(float(np.sqrt(np.mean(gap**2))) for gap in groups)),
            "largest": _upper(float(gaps.max())),
        }
    return measured


def add(key: str, measured: list[dict[str, Any]]) -> None:
    """Write the larger of each figure measured on some backends, under a key."""
    noise = json.loads(FILE.read_text()) if FILE.is_file() else {}
    write(
        {**noise, key: {name: largest([scale[name] for scale in measured]) for name in measured[0]}}
    )


def largest(scales: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the larger of each figure of several measurements of a column."""
    return {
        "quantiles": [
            max(row) for row in zip(*(scale["quantiles"] for scale in scales), strict=True)
        ],
        "rms": max(scale["rms"] for scale in scales),
        "largest": max(scale["largest"] for scale in scales),
    }


def write(noise: dict[str, Any]) -> None:
    """Write the figures of all tasks, one line for each column."""
    lines = ",\n".join(
        f"  {json.dumps(task)}: {{\n"
        + ",\n".join(f"    {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items())
        + "\n  }"
        for task, rows in sorted(noise.items())
    )
    atomic_write(FILE, f"{{\n{lines}\n}}\n".encode())


def play(task: str, backend: str, teams: int, out: Path) -> None:
    """Play published teams and random actions, and write the episodes to a file.

    Args:
        task: Task.
        backend: Physics.
        teams: Robots, and as many humans.
        out: File for the episodes.
    """
    from evaluation.cast.cast import in_release
    from evaluation.cast.roster import registry_roster
    from evaluation.play.baselines import reference_job
    from evaluation.play.evaluator import MAX_ENVS
    from evaluation.play.how import PlaySettings
    from evaluation.play.runner import play as play_job
    from evaluation.play.study import make_job
    from zoo.registry import load_registry

    registry = load_registry()
    release = registry.release_of(task)
    robots, humans = (
        in_release(registry, f"{task}/*", release, task=task, role=role)
        for role in ("robot", "human")
    )
    egos, partners = (seat[:: max(1, len(seat) // teams)][:teams] for seat in (robots, humans))
    how, humans = PlaySettings(task, EPISODES, backend=backend), registry_roster(registry, partners)
    env, job = make_job(how, registry_roster(registry, egos), humans)
    random = dataclasses.replace(reference_job(env, job, RANDOM), episodes=EPISODES * teams)
    jobs = (job, random)
    played = [play_job(env, job_to_play, MAX_ENVS[backend]) for job_to_play in jobs]
    pl.concat(played).write_parquet(out)


def _play_twice(task: str, backend: str, teams: int) -> list[pl.DataFrame]:
    """Return the episodes of two processes, which round differently."""
    with tempfile.TemporaryDirectory() as folder:
        tables = []
        for place, flags in enumerate(("", OTHER)):
            out = Path(folder, f"{place}.parquet")
            words = [sys.executable, "-m", "tools.replay_noise", "play", task, backend, str(teams)]
            subprocess.run([*words, str(out)], env={**os.environ, "XLA_FLAGS": flags}, check=True)
            tables.append(read_parquet(out))
        return tables


def _upper(value: float) -> float:
    """Return a value rounded up to two digits."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit) * unit:.3g}")


if __name__ == "__main__":
    app = App(name="python -m tools.replay_noise", help=__doc__, default_command=measure)
    app.command(play)
    app()
