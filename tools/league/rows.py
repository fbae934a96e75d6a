"""Rows of a league, as a table of how their robots are made."""

import dataclasses
from typing import Literal

from assistax_envs.preferences import Told
from evaluation.figures.league import (
    BEST_OF_FOUR,
    FIXED,
    KNOWING,
    KNOWING_MEMORY,
    KNOWING_NUMBERS,
    KNOWING_RESPONSE,
    MIRROR,
    OF_PERSONS,
    PPO,
    RESPONSE,
    ordered,
)
from population.config import MIXED
from population.method_presets import METHODS

# Partners of the training: the training side; the test side; one partner of the test side each. The
# last two have no training: the best published robot, or the best of each four of another row.
Source = Literal["train", "test", "each", "published", "best-of"]


@dataclasses.dataclass(frozen=True)
class Row:
    """Row of a league, and how its robots are made."""

    name: str
    source: Source
    algorithm: str = PPO
    told: Told = False
    mixed: bool = False  # whether it learns with teams beside persons
    teacher: str = ""  # row whose best robots it imitates

    @property
    def of(self) -> str:
        """Name of the row that provides the training."""
        return PPO if self.source == "best-of" else self.name

    @property
    def of_persons(self) -> bool:
        """Whether it plays the persons alone, where teams stand beside them."""
        return self.name in OF_PERSONS

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of its stages, in order."""
        training = () if self.source == "published" else ("training",)
        validation = () if self.source in ("test", "each") else ("validation",)
        return (*training, *validation, "evaluation")

    def stage(self, name: str) -> str:
        """Return a stage with its number, such as "stage 2 of 3, validation of gru"."""
        place = self.stages.index(name) + 1
        return f"stage {place} of {len(self.stages)}, {name} of {self.name}"


def rows() -> dict[str, Row]:
    """Return all rows that can be made, by name, in the league's order.

    Zero, random and script are in every row's folder as references.
    """
    methods = [Row(name, "train", name) for name in (PPO, "sac", *METHODS)]
    others = [
        Row(FIXED, "published"),
        Row(BEST_OF_FOUR, "best-of"),
        Row("dagger", "train", "dagger", teacher=KNOWING_MEMORY),
        Row(MIXED, "train", "asymmetric_gru", mixed=True),
        Row(KNOWING, "train", told=True),
        Row(KNOWING_MEMORY, "train", "gru", told=True),
        Row(KNOWING_NUMBERS, "train", told="partner"),
        Row(MIRROR, "test"),
        Row(RESPONSE, "each"),
        Row(KNOWING_RESPONSE, "each", told=True),
    ]
    known = {row.name: row for row in (*methods, *others)}
    return {name: known[name] for name in ordered(known)}


def named(name: str) -> Row:
    """Return the row of a name.

    Raises:
        ValueError: There is no such row; the message lists the allowed ones.
    """
    known = rows()
    if name not in known:
        raise ValueError(f"row is {name!r}; allowed are {', '.join(known)}")
    return known[name]
