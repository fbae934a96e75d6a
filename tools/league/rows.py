"""The rows of a league, as a table: how the robots of each come to be."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

from evaluation.ego_training import ROWS as TRAINED
from evaluation.figures.league import (
    BEST_OF_FOUR,
    FIXED,
    MIRROR,
    PPO,
    RESPONSE,
    TOLD,
    TOLD_RESPONSE,
    ordered,
)

# With whom robots train: the training side; the test side; one partner of the test side each; or
# nobody, because the best published robot is taken, or the best of each four of another row.
Source = Literal["train", "test", "each", "published", "best-of"]


@dataclasses.dataclass(frozen=True)
class Row:
    """How the robots of a row come to be."""

    name: str
    source: Source
    algorithm: str = PPO
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    told: bool = False  # whether robots observe what the human likes

    @property
    def of(self) -> str:
        """The row whose training this one needs."""
        return PPO if self.source == "best-of" else self.name


def rows() -> dict[str, Row]:
    """Return all rows that can be made, by name, in the league's order.

    Zero, random and script stand in every row's folder as references.
    """
    methods = [Row(name, "train", *made) for name, made in TRAINED.items()]
    others = [
        Row(FIXED, "published"),
        Row(BEST_OF_FOUR, "best-of"),
        Row(TOLD, "train", told=True),
        Row(MIRROR, "test"),
        Row(RESPONSE, "each"),
        Row(TOLD_RESPONSE, "each", told=True),
    ]
    known = {row.name: row for row in (*methods, *others)}
    return {name: known[name] for name in ordered(known)}


def named(name: str) -> Row:
    """Return the row of a name.

    Raises:
        ValueError: There is none; says which there are.
    """
    known = rows()
    if name not in known:
        raise ValueError(f"row is {name!r}; allowed are {', '.join(known)}")
    return known[name]
