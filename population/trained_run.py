"""A finished run, read back: its teams or egos, their self-play and their policies. NumPy alone."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors.numpy

from population.config import TrainConfig
from population.run_folder import RunFolder
from population.spec import PolicySpec
from population.stack import PolicyStack, unflatten


@dataclasses.dataclass(frozen=True)
class TrainedRun:
    """What a run made, member by member in the order of `config.members`."""

    folder: Path
    config: TrainConfig
    names: tuple[str, ...]  # "task/algorithm-setting-sN" of each member
    training: Mapping[str, Any]  # steps, seconds, device, versions, and what else was recorded
    # `mean`, `iqm`, `mean_ci`, `n` and `success` of each team; None of egos, and where left out.
    self_play: tuple[Mapping[str, Any] | None, ...]
    policies: Mapping[str, PolicyStack]  # by role; ids are "NAME/ROLE"


def read_trained_run(folder: Path | str) -> TrainedRun:
    """Return the finished run of a folder that this machine wrote.

    Raises:
        OSError: The run is not finished.
    """
    run = RunFolder(folder)
    teams, config = json.loads(run.teams.read_text()), run.config()
    names = tuple(f"{config.task}/{config.algorithm}-{member.label}" for member in config.members)
    policies = {}
    for role, place in teams[0]["roles"].items():
        leaves = safetensors.numpy.load_file(run.folder / place["file"])
        ids = tuple(f"{name}/{role}" for name in names)
        policies[role] = PolicyStack(PolicySpec(**place["spec"]), ids, unflatten(leaves))
    return TrainedRun(
        run.folder,
        config,
        names,
        teams[0]["training"],
        tuple(team["self_play"] for team in teams),
        policies,
    )
