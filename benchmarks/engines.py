"""Comparison of returns on two engines: self-play of published teams, paired by team and start.

python -m benchmarks.engines --task scratch --teams 30 --episodes 64
python -m benchmarks.engines --task scratch --theirs fused --planted actuator_gear --factor 1.01
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from cyclopts import run

from assistax_envs import make
from assistax_envs.physics import make_physics
from assistax_zoo.shell.console import print_json, stdout_is_data
from evaluation.cast.roster import paired_rosters
from evaluation.play.evaluator import run_job
from evaluation.play.jobs import Job
from zoo.registry import load_registry

EQUIVALENT = 0.005  # share of the mean return below which engines are equivalent


def compare(
    task: str,
    teams: int,
    episodes: int,
    ours: str,
    theirs: str,
    planted: tuple[str, float] | None = None,
) -> dict[str, Any]:
    """Return the difference of mean returns of two engines, with its interval and the verdict.

    `teams` of the task's teams are taken at even distances in the registry's order, so that all
    algorithms and impairments are among them. The 95% interval is over teams; the engines are
    equivalent if all of it is within `EQUIVALENT`. `planted` is a defect of `ours`.
    """
    played = _returns(task, teams, episodes, ours, planted), _returns(task, teams, episodes, theirs)
    means, means_theirs = (
        table.group_by("ego_team").agg(pl.col("return").mean()) for table in played
    )
    joined = means.join(means_theirs, on="ego_team", suffix="_theirs")
    difference = (joined["return"] - joined["return_theirs"]).to_numpy()
    mean = float(joined["return_theirs"].mean())  # ty: ignore
    margin = 1.96 * float(difference.std(ddof=1)) / np.sqrt(len(difference))
    return {
        "teams": len(difference),
        "episodes": episodes,
        "mean": mean,
        "difference_share": float(difference.mean()) / abs(mean),
        "margin_share": margin / abs(mean),
        "equivalent": abs(float(difference.mean())) + margin < EQUIVALENT * abs(mean),
        "largest_of_a_team": float(np.abs(difference).max()),
        "nonfinite": int(played[0]["nonfinite"].sum()),
        "nonfinite_theirs": int(played[1]["nonfinite"].sum()),
    }


def _returns(
    task: str, teams: int, episodes: int, backend: str, planted: tuple[str, float] | None = None
) -> pl.DataFrame:
    """Return the episodes of teams on one engine, with a planted defect if one is given."""
    registry, env = load_registry(), make(task, backend)
    if planted:
        field, factor = planted
        getattr(env.model, field)[:] *= factor
        env._physics = make_physics(env.model, env.backend)
    entries = {entry.id: entry for entry in registry.policies if entry.task == task}
    pairs = [
        (entry, entries[f"{entry.team}/human"])
        for entry in entries.values()
        if entry.role == "robot" and f"{entry.team}/human" in entries
    ]
    picked = [pairs[i] for i in np.linspace(0, len(pairs) - 1, teams).astype(int)]
    robots, humans = paired_rosters(registry, picked)
    job = Job(
        task=task,
        env_version=env.version,
        backend=env.backend,
        egos=robots,
        partners=humans,
        episodes=episodes,
        paired=True,
    )
    with tempfile.TemporaryDirectory() as folder:
        return run_job(env, job, Path(folder, "job")).table


def main(
    task: str,
    *,
    teams: int = 30,
    episodes: int = 64,
    ours: str = "fused",
    theirs: str = "native",
    planted: str | None = None,
    factor: float = 1.01,
) -> None:
    """Print the comparison as JSON; `planted` is a field of the model that `ours` has wrong."""
    defect = (planted, factor) if planted else None
    with stdout_is_data():
        result = compare(task, teams, episodes, ours, theirs, defect)
    print_json({"task": task, "ours": ours, "theirs": theirs, "planted": defect, **result})


if __name__ == "__main__":
    run(main)
