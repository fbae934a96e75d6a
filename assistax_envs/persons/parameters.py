"""The 25 numbers of a person: name, unit, range and source. Imports no JAX or MuJoCo.

A number is the quantile of its own distribution, so that a point of the unit cube is a person. A
source says what was read: "memory" marks a figure that was written down without its source at
hand, "design" one that nobody measured and that we chose.
"""

import dataclasses
import math
from statistics import NormalDist

from assistax_envs.registered import REGISTERED
from assistax_envs.versions import GENTLE_TASKS, PAPER_TASKS

_NORMAL = NormalDist()


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number of a person."""

    name: str
    unit: str  # "1" for a share
    low: float
    high: float
    source: str
    meaning: str
    median: float | None = None  # of a log-normal distribution, cut to the range
    sigma: float = 0.0  # of its logarithm; without a median the distribution is uniform
    none: float = 0.0  # share of persons who have none of it: their number is 0

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


_GOMI = "Gomi and Osu 1998, J Neurosci 18:8965, for its form; the scale is a design"
_WISH = "King et al. 2010, IROS: below 3 N wipe skin clean; Proc IMechE H 2023, 237:829"
_PLACE = "design: the gentle tasks' own range"

_BODY = (
    Parameter(
        "strength", "1", 0.4, 1.0,
        "d1 to d9 of the paper; MRC grade 4 holds 96% of elbow strength (MacAvoy and Green 2007)",
        "share of the torques of the seat, half of what is missing spared in gentle scenes",
    ),
    Parameter(
        "range", "1", 0.4, 1.0, "d1 to d9 of the paper",
        "share of the elbow's range about its rest angle, spared likewise",
    ),
    Parameter(
        "tremor_frequency", "Hz", 4.0, 12.0,
        "essential tremor, 4 to 12 Hz: Bhatia et al. 2018 as summarised in PMC12219005",
        "of the tremor",
    ),
    Parameter(
        "tremor", "1", 0.02, 0.3, "design: 0.3 of the torque moves the hand by millimetres",
        "amplitude as a share of the strength", none=0.4,
    ),
    Parameter(
        "spasticity", "N m s/rad", 0.2, 5.0,
        "2 on average: elbow, 2.8 N m at 5 and 6.3 at 100 deg/s (PMC5345015); the end is a design",
        "torque of the elbow's flexors against fast stretching", none=0.5,
    ),
    Parameter(
        "catch_speed", "rad/s", 0.3, 1.5,
        "stretches of 15 to 150 deg/s show it: McPherson et al. 2018, Exp Brain Res 237:121",
        "of stretching, from where on spasticity acts",
    ),
    Parameter(
        "fatigue", "1/min", 0.0, 1.0, "memory: Rohmert 1960, full effort lasts about a minute",
        "share of strength that a minute of full effort costs",
    ),
    Parameter(
        "slow_start", "s", 0.1, 1.5, "memory: slowed initiation in Parkinson's disease",
        "from the wish to move to the movement",
    ),
)  # fmt: skip
_CONTROL = (
    Parameter("stiffness", "1", 0.3, 2.0, _GOMI, "of the arm against that of healthy adults"),
    Parameter(
        "delay", "s", 0.06, 0.3,
        "memory: 60 ms long-latency reflex (Pruszynski and Scott 2012), 300 ms choice reaction",
        "of what is felt",
    ),
    Parameter(
        "noise", "1", 0.02, 0.25,
        "torque varies in proportion to itself: Hamilton et al. 2004, Exp Brain Res 157:417; "
        "the ends are a design",
        "standard deviation of the torque as a share of it",
    ),
    Parameter(
        "gravity", "1", 0.7, 1.0, "design", "share of the arm's weight that is carried unasked"
    ),
)  # fmt: skip
_INTENTION = (
    Parameter(
        "pace", "s/bit", 0.1, 0.5, "memory: Fitts 1954 found 0.1 s/bit; slower is a design",
        "of movements, by Fitts' law",
    ),
    Parameter(
        "initiative", "1", 0.0, 1.0, "design",
        "helps when pushed (below 1/3), when touched (below 2/3), or before anybody comes",
    ),
    Parameter("lapses", "1/min", 0.0, 6.0, "design", "how often attention goes for 1 s"),
    *(
        Parameter(
            f"belief_{joint}", "rad", -0.25, 0.25, "design",
            f"how far from the posture that helps this person believes {words} should be",
        )
        for joint, words in (
            ("shoulder1", "the first shoulder joint"),
            ("shoulder2", "the second shoulder joint"),
            ("elbow", "the elbow"),
        )
    ),
)  # fmt: skip
_TOUCH = (
    Parameter("liked_force", "N", 1.5, 10.0, _WISH, "of the tool on the skin", 4.0, 0.5),
    Parameter(
        "liked_speed", "m/s", 0.02, 0.12,
        "strokes of 1 to 10 cm/s please most: Loken et al. 2009, Nat Neurosci 12:547",
        "of the tool over the skin", 0.05, 0.6,
    ),
    Parameter(
        "tolerance", "1", 1.5, 5.0,
        "design: 10 N on average; Proc IMechE H 2023 has 11.1 N (shaving) to 55.7 N (hair)",
        "force that hurts, in liked forces", 2.5, 0.3,
    ),
)  # fmt: skip
_CARRIED = (
    Parameter("liked_distance", "m", 0.1, 0.6, _PLACE, "of the hook from the arm", 0.25, 0.6),
    Parameter("liked_place", "m", 0.1, 0.3, _PLACE, "across the waist, where the arm should lie"),
    Parameter(
        "tolerance", "1", 1.5, 4.0,
        "design: 40 N on average, in weights of the forearm, 16 N",
        "force that hurts, in weights of the forearm", 2.5, 0.3,
    ),
)  # fmt: skip
_REACTION = (
    Parameter(
        "settle", "s", 0.15, 0.6, "design: about 0.3 s", "how fast discomfort comes and goes"
    ),
    Parameter("withdraw", "rad", 0.05, 0.3, "design: about 0.15 rad", "way back for discomfort 1"),
    Parameter("lean", "rad", 0.02, 0.1, "design: about 0.05 rad", "way towards too light a touch"),
    Parameter("limit", "1", 0.6, 1.5, "design: about 1", "discomfort that ends the help"),
)

_SKIN = (*_BODY, *_CONTROL, *_INTENTION, *_TOUCH, *_REACTION)
# Whoever is carried has to find its place itself: 0.25 rad off, a third of persons could not rest
# within 6 cm of it, whoever brought them there; 2% cannot who are not off at all.
_NEAR = tuple(
    dataclasses.replace(number, low=-0.1, high=0.1) if number.name.startswith("belief") else number
    for number in _INTENTION
)
_LIFT = (*_BODY, *_CONTROL, *_NEAR, *_CARRIED, *_REACTION)
# Of the tasks at the mouth: what takes the place of numbers of an arm.
_OF_MOUTH = {
    "range": Parameter(
        "range", "1", 0.4, 1.0, "d1 to d9 of the paper",
        "share of the neck's and jaw's range, half of what is missing spared",
    ),
    "spasticity": Parameter(
        "bite_reflex", "N m", 0.02, 0.2, "design: 2 N between the lips at most",
        "torque of the jaw for a quarter of a second after a touch in the mouth", none=0.6,
    ),
    "catch_speed": Parameter(
        "bite_onset", "N", 0.5, 4.0, "design", "of a touch, from where on the bite reflex acts"
    ),
    "stiffness": Parameter(
        "stiffness", "1", 0.3, 2.0, "design: 1 is half of the scene's springs",
        "with which trunk, neck and jaw hold where they should be",
    ),
    "gravity": Parameter(
        "wander", "rad", 0.0, 0.08, "design", "how far the head wanders about where it should be"
    ),
    "initiative": Parameter(
        "initiative", "1", 0.0, 1.0, "design", "how soon it opens or turns, from half as soon on"
    ),
    "belief_shoulder1": Parameter(
        "belief_pitch", "rad", -0.08, 0.08, "design",
        "how far from the posture that helps this person believes the neck should nod",
    ),
    "belief_shoulder2": Parameter(
        "belief_yaw", "rad", -0.1, 0.1, "design", "likewise, how far it should turn"
    ),
    "belief_elbow": Parameter(
        "belief_jaw", "rad", -0.08, 0.08, "design", "likewise, how far the jaw should open"
    ),
}  # fmt: skip
_FED = (
    Parameter("liked_wait", "m", 0.04, 0.16, _PLACE, "of the spoon before the lips", 0.08, 0.8),
    Parameter("liked_depth", "m", 0.012, 0.028, _PLACE, "of the bowl behind the lips", 0.02, 0.3),
    Parameter(
        "tolerance", "1", 1.5, 5.0, "design: 5 N on average, in forces of 2 N",
        "force that hurts, in forces of 2 N", 2.5, 0.3,
    ),
)  # fmt: skip
_BRUSHED = (
    Parameter("liked_press", "N", 0.5, 2.0, _PLACE, "of the brush on the teeth", 1.0, 0.5),
    Parameter("liked_speed", "m/s", 0.02, 0.08, _PLACE, "of the brush over the teeth", 0.04, 0.5),
    Parameter(
        "tolerance", "1", 2.0, 8.0, "design: 4 N on average", "force that hurts, in liked forces",
        4.0, 0.3,
    ),
)  # fmt: skip


def _at_mouth(wishes: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    numbers = (*_BODY, *_CONTROL, *_INTENTION)
    return (*(_OF_MOUTH.get(number.name, number) for number in numbers), *wishes, *_REACTION)


# Task -> its parameters, in the order of a row.
PARAMETERS: dict[str, tuple[Parameter, ...]] = {
    **dict.fromkeys((*PAPER_TASKS, *GENTLE_TASKS), _SKIN),
    "gentle_lift": _LIFT,
    "arm_assist": _LIFT,
    "gentle_feeding": _at_mouth(_FED),
    "gentle_brushing": _at_mouth(_BRUSHED),
}
WIDTH = len(_SKIN)  # numbers of a row
FOREARM = 16.0  # N: what a forearm and a hand weigh, and a force at which a carried arm is at ease
SPARED = {task: 0.5 if REGISTERED[task].felt else 0.0 for task in PARAMETERS}


def index(task: str) -> dict[str, int]:
    """Return where in a row of a task each number stands."""
    return {parameter.name: place for place, parameter in enumerate(PARAMETERS[task])}


def left(task: str, share: float) -> float:
    """Return what a share of strength or range leaves in a task's scene."""
    return 1.0 - (1.0 - SPARED[task]) * (1.0 - share)


# Clinicians' scales: what stands beside a number on a card. The steps are ours (design).
MRC = ((0.1, "3"), (0.35, "4-"), (0.6, "4"), (0.85, "4+"), (1.01, "5"))  # of a healthy arm
ASHWORTH = ((0.01, "0"), (0.8, "1"), (1.6, "1+"), (3.0, "2"), (9.0, "3"))  # N m s/rad


def grade(scale: tuple[tuple[float, str], ...], value: float) -> str:
    """Return the first grade of a scale whose bound lies above `value`."""
    return next(name for bound, name in scale if value < bound)
