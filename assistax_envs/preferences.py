"""Preferences p1 to p9 of humans in the gentle tasks, and words about them. Imports no JAX.

The human observes its own preference, the robot does not, and the reward of both depends on it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

from assistax_envs.registered import ByTask


@dataclasses.dataclass(frozen=True)
class Preference:
    """Preferred values of a human: of touch, place and distance."""

    force: float  # N, of the tool on its arm
    speed: float  # m/s, of the tool over its skin
    distance: float  # m, of the hook from its arm once that lies
    place: float  # m, how far across the waist its arm should lie
    wait: float = 0.08  # m, how far before the lips a spoon should wait
    depth: float = 0.02  # m, how far behind the lips its bowl should come
    press: float = 2.0  # N, of a brush on its teeth
    tolerance: float = 2.5  # force that hurts, in units of the task

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0.0:
                raise ValueError(f"preferred {name} is {value}; it must be above 0")


WIDTH = 0.35  # of liking: the standard deviation in the logarithm of done over liked
FORCES = (2.0, 4.0, 8.0)  # N
SPEEDS = (0.02, 0.04, 0.08)  # m/s
DISTANCES = (0.1, 0.25, 0.6)  # m
PLACES = (0.1, 0.2, 0.3)  # m
WAITS = (0.04, 0.08, 0.16)  # m
DEPTHS = (0.012, 0.02, 0.028)  # m
PRESSES = (1.0, 2.0, 4.0)  # N
# Secrets that a robot observes in rows to compare with: nothing, the human's preference, or all
# numbers of a person.
Told = bool | Literal["partner"]
# Quantities that humans of a task have a preference about, and observe.
PREFERRED: Mapping[str, tuple[str, ...]] = ByTask(
    lambda kind: kind.preferences, lambda kind: bool(kind.preferences)
)
VALUES = {
    "force": FORCES,
    "speed": SPEEDS,
    "distance": DISTANCES,
    "place": PLACES,
    "wait": WAITS,
    "depth": DEPTHS,
    "press": PRESSES,
}

# Speed runs fastest: p2 is the lightest touch at the middle speed, p4 the middle touch at the
# slowest. Two Latin squares, orthogonal to each other: of force, speed, distance and place any two
# values meet once. A spoon's wait and depth are a force and a speed of the mouth, and a brush
# presses less: no task has two of these.
PREFERENCES: dict[str, Preference] = {
    f"p{1 + 3 * i + j}": Preference(
        force,
        speed,
        DISTANCES[(i + j + 2) % 3],
        PLACES[(i + 2 * j + 1) % 3],
        wait=WAITS[i],
        depth=DEPTHS[j],
        press=PRESSES[i],
    )
    for i, force in enumerate(FORCES)
    for j, speed in enumerate(SPEEDS)
}
DRAWN = "drawn"  # a preference that is drawn anew, among all of them, at each episode's start


def middles(task: str) -> tuple[float, ...]:
    """Return the middle value of each quantity that a task's humans have a preference about."""
    return tuple(VALUES[name][1] for name in PREFERRED.get(task, ()))


def preferences_of(task: str) -> tuple[str, ...]:
    """Return p1 to p9, or no names for a task whose humans have no preferences."""
    return tuple(PREFERENCES) if task in PREFERRED else ()


def check_preferences(task: str, names: Sequence[str]) -> None:
    """Check names of preferences for a task.

    Raises:
        ValueError: The task has no preferences, or a name is unknown, missing or given twice.
    """
    if task not in PREFERRED:
        raise ValueError(
            f"the humans of {task} have no preferences; leave them out, or choose "
            f"{', '.join(PREFERRED)}"
        )
    unknown = [name for name in names if name not in PREFERENCES]
    if unknown or not names or len(set(names)) < len(names):
        raise ValueError(
            f"preferences are {', '.join(names) or 'none'}; give each of those that partners take "
            f"turns in once, of {', '.join(PREFERENCES)}"
        )


# Code 0 is silence; code k is WORDS[k - 1].
WORDS = ("softer", "harder", "slower", "faster", "closer", "farther", "stop", "good")
HEARD = 20  # steps for which the robot observes a word: 0.4 s
# By the name of a wish: the word of a person for whom there is too much of it, and too little.
ASKS: dict[str, tuple[str, str]] = {
    "force": ("softer", "harder"),
    "press": ("softer", "harder"),
    "speed": ("slower", "faster"),
    "distance": ("closer", "farther"),
    "wait": ("closer", "farther"),
    "depth": ("farther", "closer"),
}


def code(word: str) -> int:
    """Return the code of a word.

    Raises:
        ValueError: It is not one of `WORDS`.
    """
    if word not in WORDS:
        raise ValueError(f"word is {word!r}; allowed are {', '.join(WORDS)}")
    return WORDS.index(word) + 1
