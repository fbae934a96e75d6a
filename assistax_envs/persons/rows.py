"""Ten thousand persons a task and family: rows of numbers, dealt into sides, and their identity.

A number is the quantile of its own distribution, so that a point of the unit cube is a person. Each
task has its numbers in its own `person.py`. Imports no JAX or MuJoCo.
"""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from assistax_envs.registered import REGISTERED, ByTask
from assistax_envs.tasks.person import Parameter, PersonKind
from assistax_envs.tasks.person_numbers import SKIN

PROGRAM_VERSION = 3  # goes up when the same row acts otherwise in the same situation
FAMILIES = ("spring", "muscle", "stepper")  # forms of the controller; no robot trains with the last
ROWS = 10_000  # rows of numbers, the same for each family
COUNT = ROWS * len(FAMILIES)  # persons: those of a family follow each other
INNER = 8_000  # rows inside 80% of every axis; from here to ROWS: corners
BEYOND = 10  # of a corner's axes at least lie beyond it, or all of its wishes: of 30 a point of the
# whole cube has 6 there on average
BITS = 30  # of a coordinate
SIDES = ("training", "validation", "test")
UNSEEN = "stepper"  # the family that no robot trains with


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


@dataclasses.dataclass(frozen=True)
class Person:
    """A person: a row of numbers with task, number, side and family."""

    task: str
    number: int
    side: str  # one of SIDES
    family: str  # one of FAMILIES
    row: np.ndarray  # [30] float32

    @property
    def name(self) -> str:
        """Return its name in the registry."""
        return f"person-{self.number:05d}"

    @property
    def identity(self) -> str:
        """Return the SHA-256 of the program's version, the family, the task and the row."""
        head = f"person program {PROGRAM_VERSION} {self.family} {self.task}\n"
        return hashlib.sha256(head.encode() + self.row.astype("<f4").tobytes()).hexdigest()


def person(task: str, number: int) -> Person:
    """Return a person of a task.

    Raises:
        ValueError: there is no such task or number.
    """
    person_kind(task)
    if not 0 <= number < COUNT:
        raise ValueError(f"person {number} is not there; allowed are 0 to {COUNT - 1}")
    return Person(task, number, side(number), family(number), persons(task)[number % ROWS])


def family(number: int) -> str:
    """Return the family of a person."""
    return FAMILIES[number // ROWS]


@functools.cache
def persons(task: str) -> np.ndarray:
    """Return the rows of a task's persons, [10000, 30] float32, read-only.

    Person n has row n modulo 10,000: each family has a person with each row.

    Raises:
        ValueError: there is no such task.
    """
    person_kind(task)
    table = _rows(task, _points(task))
    table.flags.writeable = False
    return table


def side(number: int) -> str:
    """Return the side of a person.

    Training: inside; validation: each tenth of those; test: corners, and the unseen family.
    """
    if number % ROWS >= INNER or family(number) == UNSEEN:
        return "test"
    return "validation" if number % 10 == 9 else "training"


def numbers(of: str) -> np.ndarray:
    """Return the numbers of all persons of a side, in order.

    Raises:
        ValueError: there is no such side.
    """
    if of not in SIDES:
        raise ValueError(f"side is {of!r}; allowed are {', '.join(SIDES)}")
    return np.array([number for number in range(COUNT) if side(number) == of])


def drawn(task: str, secret: bytes, count: int) -> np.ndarray:
    """Return rows [count, 30] of persons from anywhere in the cube, from a secret.

    The same secret gives the same rows: a season's hidden persons need no storage.
    """
    person_kind(task)
    size = count * WIDTH
    stream = hashlib.shake_256(b"persons of " + task.encode() + b" from " + secret).digest(8 * size)
    shares = (np.frombuffer(stream, "<u8") >> 11).astype(np.float64) / 2.0**53
    return _rows(task, shares.reshape(count, WIDTH))


def card(someone: Person) -> str:
    """Return a person's numbers as text, each with its range, and clinicians' grades."""
    lines = [f"{someone.name} of {someone.task}: {someone.side}, {someone.family}"]
    lines.append(f"identity {someone.identity}")
    for name, number in described_numbers(someone).items():
        unit = "" if number["unit"] == "1" else f" {number['unit']}"
        bounds = f"{number['low']:g} to {number['high']:g}{unit}"
        none = f", none in {number['none']:.0%}" if number["none"] else ""
        lines.append(f"{name:17} {number['value']:8.4g}{unit:10} [{bounds}{none}]")
    return "\n".join([*lines, *(f"{name}: {text}" for name, text in grades(someone).items())])


def described_numbers(someone: Person) -> dict[str, dict[str, Any]]:
    """Return a person's numbers by name: value, unit, low, high, and share of persons without."""
    return {
        parameter.name: {
            "value": float(f"{value:.4g}"),
            **{name: getattr(parameter, name) for name in ("unit", "low", "high", "none")},
        }
        for parameter, value in zip(PARAMETERS[someone.task], someone.row, strict=True)
    }


def grades(someone: Person) -> dict[str, str]:
    """Return grades of some of a person's numbers on clinicians' scales, by the scale's name."""
    task, row, place = someone.task, someone.row, index(someone.task)
    strength = left(task, float(row[place["strength"]]))
    share = left(task, float(row[place["range"]]))
    named = {"MRC grade of what a seat at full strength leaves": grade(MRC, strength)}
    if "spasticity" not in place:
        return named | {"range of motion of neck and jaw": f"{share:.0%}"}
    return named | {
        "modified Ashworth": grade(ASHWORTH, float(row[place["spasticity"]])),
        "range of motion of the elbow": f"{share:.0%}",
    }


def _rows(task: str, points: np.ndarray) -> np.ndarray:
    """Return the rows of points [P, 30] of the unit cube."""
    rows = [
        [number.quantile(share) for number, share in zip(PARAMETERS[task], point, strict=True)]
        for point in points.tolist()
    ]
    return np.array(rows, np.float32)


def _points(task: str) -> np.ndarray:
    """Return points [10000, 30] of the unit cube: first those inside, then corners.

    Sobol's numbers by Joe and Kuo, shifted by bits of the task's name: a scrambling that no other
    version of a library draws otherwise.
    """
    from scipy.stats import qmc

    size = 2**16
    plain = qmc.Sobol(WIDTH, scramble=False, bits=BITS).random(size)
    digest = hashlib.shake_256(b"persons of " + task.encode()).digest(4 * WIDTH)
    shift = np.frombuffer(digest, "<u4") >> (32 - BITS)
    points = ((plain * 2.0**BITS).astype(np.uint32) ^ shift) / 2.0**BITS
    beyond = np.abs(points - 0.5) > 0.4
    wishes = [place for name, place in index(task).items() if name.startswith("liked_")]
    corner = (beyond.sum(axis=1) >= BEYOND) | beyond[:, wishes].all(axis=1)
    begin = 2**14  # corners come from what follows, all others from before it
    corners = points[begin:][corner[begin:]]
    return np.concatenate([0.1 + 0.8 * points[:INNER], corners[: ROWS - INNER]])


# Clinicians' scales: what stands beside a number on a card. The steps are ours (design).
MRC = ((0.1, "3"), (0.35, "4-"), (0.6, "4"), (0.85, "4+"), (1.01, "5"))  # of a healthy arm
ASHWORTH = ((0.01, "0"), (0.8, "1"), (1.6, "1+"), (3.0, "2"), (9.0, "3"))  # N m s/rad


def grade(scale: tuple[tuple[float, str], ...], value: float) -> str:
    """Return the first grade of a scale whose bound lies above `value`."""
    return next(name for bound, name in scale if value < bound)
