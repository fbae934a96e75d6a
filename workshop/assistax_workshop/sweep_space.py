"""Space of a sweep: ranges of continuous hyperparameters, and values of discrete ones."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from assistax_base.validated import first_problem, validated


@validated
class Range:
    """Range of a continuous hyperparameter."""

    low: float
    high: float
    log: bool = True  # whether values are uniform in their logarithm

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            positive = "0 < " if self.log else ""
            raise ValueError(
                f"a range is from {self.low} to {self.high}; it must have {positive}low < high"
            )

    def draw(self, rng: np.random.Generator) -> float:
        """Return a drawn value, rounded to four digits."""
        if self.log:
            value = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        else:
            value = rng.uniform(self.low, self.high)
        return float(f"{value:.4g}")


Value = bool | int | float | str | tuple[int, ...]
# A tuple holds the values of a discrete hyperparameter.
Space = Mapping[str, Range | Annotated[tuple[Value, ...], Field(min_length=1)]]

SPACES: Mapping[str, Space] = {
    "ppo": {
        "learning_rate": Range(1e-4, 1e-2),
        "clip_eps": Range(0.05, 0.4, log=False),
        "entropy_coef": Range(1e-5, 1e-2),
        "rollout_steps": (64, 128),
    },
    "sac": {
        "policy_lr": Range(1e-4, 3e-3),
        "q_lr": Range(1e-4, 3e-3),
        "tau": Range(1e-3, 2e-2),
        "target_entropy_scale": Range(0.5, 5.0, log=False),
        "updates": (16, 32),
    },
}


def read_space(path: Path) -> Space:
    """Return the space of a JSON file: {"low", "high", "log"} for a range, a list for values.

    Raises:
        ValueError: It is not an object of such values.
        OSError: It cannot be read.
    """
    kind: TypeAdapter[Space] = TypeAdapter(Annotated[Space, Field(min_length=1)])
    try:
        return kind.validate_json(path.read_bytes(), strict=True)
    except ValidationError as error:
        raise ValueError(
            f'{path}: {first_problem(error)}; give an object of hyperparameters, each {{"low": '
            '1e-4, "high": 1e-2, "log": true} or a list such as [64, 128]'
        ) from None
