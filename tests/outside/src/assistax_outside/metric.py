"""A metric with a column of the episode table: how unsteadily a robot presses on the human."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from evaluation.figures.metrics.installed import Metric
from evaluation.record.record import Returns
from population.environment import EnvState
from population.play.tally import Column

STEPS_A_SECOND = 50


class ForceChange(Column):
    """Mean change of the force between steps, N/s."""

    def add(self, value: Any, before: EnvState, state: EnvState, time: jax.Array) -> Any:
        """Add a step's change, N."""
        return value + jnp.abs(state.measures.force - before.measures.force)

    def end(self, value: Any, steps: np.ndarray) -> np.ndarray:
        """Return the mean over an episode's steps."""
        return STEPS_A_SECOND * value / np.maximum(steps, 1)


def values(returns: Returns) -> np.ndarray:
    """Return the change of the force in each episode [E, P, K]."""
    return returns.column("metric_unsteadiness")


UNSTEADINESS = Metric("change of the force, N/s", values, ForceChange())
