"""Persons of a task: the numbers they are made of, what they observe, how they help.

Imports no JAX or MuJoCo. `assistax_envs.persons` has the program that plays them.
"""

import dataclasses
import math
from itertools import accumulate
from statistics import NormalDist
from typing import ClassVar, Literal

_NORMAL = NormalDist()
# A human's observation begins with these parts, by name and width: of a seat that moves the right
# arm, and of one that moves trunk, neck and jaw. "tool" is the tool's place in the world, there in
# the mouth's frame and in 10 cm.
ARM_SEEN = (
    ("position", 9),
    ("velocity", 9),
    ("tool", 3),
    ("orientation", 4),
    ("force", 3),
    ("lower_arm", 3),
    ("upper_arm", 3),
    ("towards", 3),
)
HEAD_SEEN = (
    ("position", 7),
    ("velocity", 7),
    ("hand", 3),
    ("orientation", 4),
    ("force", 3),
    ("mouth", 3),
    ("forward", 3),
    ("tool", 3),
)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A number of a person: its unit, range and distribution."""

    name: str
    unit: str  # "1" for a share
    low: float
    high: float
    source: str
    meaning: str
    median: float | None = None  # of a log-normal distribution, cut to the range
    sigma: float = 0.0  # of its logarithm; without a median the distribution is uniform
    none: float = 0.0  # share of persons without it: their number is 0

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(f"{self.name}'s range is {self.low} to {self.high}; give low < high")

    def quantile(self, share: float) -> float:
        """Return the number of which `share` in [0, 1] of all persons have less.

        Rounded to four significant digits: a card prints a person exactly, and the last bit of a
        logarithm, which differs among machines, is no part of anybody.
        """
        if share < self.none:
            return 0.0
        share = (share - self.none) / (1.0 - self.none)
        if self.median is None:
            return _rounded(self.low + share * (self.high - self.low))
        begin, end = (
            _NORMAL.cdf(math.log(bound / self.median) / self.sigma)
            for bound in (self.low, self.high)
        )
        inner = min(max(begin + share * (end - begin), 1e-9), 1.0 - 1e-9)
        value = self.median * math.exp(self.sigma * _NORMAL.inv_cdf(inner))
        return _rounded(min(max(value, self.low), self.high))

    def holds(self, value: float) -> bool:
        """Return whether a person may have this number."""
        return self.low <= value <= self.high or (self.none > 0.0 and value == 0.0)


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


@dataclasses.dataclass(frozen=True)
class ArmHelp:
    """Help that a person gives with its right arm: the posture that it looks for.

    Attributes:
        chooses: "presents" one point to the tool, "shows" many, or "brings" the forearm to its
            place.
        again: Steps after which a person looks for a better posture; 0 for never.
        hidden: Arc about each of the two segments of the arm, degrees from its frame's x to its
            y, that the tool cannot reach while the arm rests.
        most: Share of the seat's torque that holding the posture may take.
        points: Place "MODULE:FUNCTION" of the points to show: from the model to their segments [K]
            and offsets [K, 3].
        across: Direction in which the preferred place of the forearm lies, and the preference at
            which it is the observed place, m; None if the place is the same for all.
    """

    chooses: Literal["presents", "shows", "brings"]
    again: int = 0
    hidden: tuple[tuple[float, float], ...] = ()
    most: float = math.inf
    points: str = ""
    across: tuple[tuple[float, float, float], float] | None = None
    torques: ClassVar = 3


@dataclasses.dataclass(frozen=True)
class HeadHelp:
    """Help that a person gives with head and mouth, as two functions of `mouth.Perceived`.

    Attributes:
        feel: Place "MODULE:FUNCTION" of the function that returns a `mouth.Comfort`.
        intend: Place of the function that returns the seconds [N] for which the person has been
            willing, and the wanted posture [N, 5], rad.
    """

    feel: str
    intend: str
    torques: ClassVar = 5


@dataclasses.dataclass(frozen=True)
class PersonKind:
    """Persons of a task.

    Attributes:
        parameters: The numbers of a person, in the order of a row.
        layout: Parts of the human's observation in order, by name and width. An arm reads the
            names of `persons.senses`; a head reads "position", "tool", "progress" (one-hot stage or
            place), "touch" and "flag" (whatever the task lets it remember).
        help: Help that persons give.
        touch_unit: Force of an observed touch of 1, N.
    """

    parameters: tuple[Parameter, ...]
    layout: tuple[tuple[str, int], ...]
    help: ArmHelp | HeadHelp
    touch_unit: float = 10.0

    @property
    def seat_size(self) -> tuple[int, int]:
        """Width of the human's observation, and number of its torques."""
        return sum(width for _, width in self.layout), self.help.torques

    @property
    def columns(self) -> dict[str, slice]:
        """Columns of the human's observation by part."""
        names, widths = zip(*self.layout, strict=True)
        ends = accumulate(widths)
        return {n: slice(e - w, e) for n, w, e in zip(names, widths, ends, strict=True)}
