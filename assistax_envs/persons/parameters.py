"""The numbers of a person by task, and clinicians' grades of them. Imports no JAX or MuJoCo.

A number is the quantile of its own distribution, so that a point of the unit cube is a person. Each
task has its numbers in its own `person.py`.
"""

from collections.abc import Mapping

from assistax_envs.registered import REGISTERED, ByTask
from assistax_envs.tasks.person import Parameter, PersonKind
from assistax_envs.tasks.person_numbers import SKIN


def person_kind(task: str) -> PersonKind:
    """Return the persons of a task.

    Raises:
        ValueError: The task is unknown or has no persons.
    """
    person = REGISTERED[task].person if task in REGISTERED else None
    if person is None:
        raise ValueError(f"task is {task!r}; allowed are {', '.join(PARAMETERS)}")
    return person


# A row of a person has them in this order.
PARAMETERS: Mapping[str, tuple[Parameter, ...]] = ByTask(
    lambda kind: person_kind(kind.name).parameters, lambda kind: kind.person is not None
)
WIDTH = len(SKIN)  # numbers of a row


def index(task: str) -> dict[str, int]:
    """Return the place of each number in a row of a task, by name."""
    return {parameter.name: place for place, parameter in enumerate(PARAMETERS[task])}


def left(task: str, share: float) -> float:
    """Return the share of strength or range that is left in a task's scene."""
    return 1.0 - (1.0 - REGISTERED[task].spared) * (1.0 - share)


# Clinicians' scales: what stands beside a number on a card. The steps are ours (design).
MRC = ((0.1, "3"), (0.35, "4-"), (0.6, "4"), (0.85, "4+"), (1.01, "5"))  # of a healthy arm
ASHWORTH = ((0.01, "0"), (0.8, "1"), (1.6, "1+"), (3.0, "2"), (9.0, "3"))  # N m s/rad


def grade(scale: tuple[tuple[float, str], ...], value: float) -> str:
    """Return the first grade of a scale whose bound lies above `value`."""
    return next(name for bound, name in scale if value < bound)
