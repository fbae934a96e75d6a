"""Detection and description of a run whose losses are not finite."""

from collections.abc import Mapping

import numpy as np
import polars as pl

from population.config import TrainConfig
from population.runs.checkpoints import Checkpoints

_LOSSES = (
    "policy_loss",
    "value_loss",
    "model_loss",
    "q_loss",
    "entropy",
    "alpha",
    "actor_grad_norm",
    "critic_grad_norm",
)


class DivergedError(ValueError):
    """Error for a loss that is not a finite number."""


def find_divergence(values: Mapping[str, np.ndarray]) -> tuple[str, int] | None:
    """Return the first loss that is not finite and its member's index; None if all are finite."""
    for name, value in values.items():
        if name.startswith(_LOSSES) and not np.isfinite(value).all():
            return name, int(np.argwhere(~np.isfinite(value))[0, 1])
    return None


def describe_divergence(
    bad: tuple[str, int], rows: pl.DataFrame, config: TrainConfig, checkpoints: Checkpoints
) -> str:
    """Return a message with the diverged member and metric, the last checkpoint and a remedy."""
    name, index = bad
    member, last = config.members[index], checkpoints.latest()
    kept = (
        f"the last good checkpoint is of update {last}" if last else "no checkpoint was written yet"
    )
    rates = {
        name: member.overrides.get(name, getattr(config.trainer, name))
        for name in config.trainer.rates
    }
    lower = ", ".join(f"{name} below {rate:g}" for name, rate in rates.items())
    return (
        f"training diverged: {name} of member {member.label} is {rows[name][index]} "
        f"by update {rows['update'].max()}; {kept} in {checkpoints.folder}; "
        f"start a new run with a {lower} or a max_grad_norm below {config.trainer.max_grad_norm:g}"
    )
