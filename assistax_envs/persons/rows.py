"""Ten thousand persons a task and family: rows of numbers, dealt into sides, and their identity.

A number is the quantile of its own distribution, so that a point of the unit cube is a person. Each
task has its numbers in its own `person.py`. Imports no JAX or MuJoCo.
"""

import dataclasses
import functools
import hashlib
import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from assistax_base.extensions import FAMILIES as ADDED
from assistax_base.extensions import Extension, extensions, files_sha256
from assistax_envs import compiled
from assistax_envs.registered import REGISTERED, ByTask
from assistax_envs.tasks.person import Parameter, PersonKind
from assistax_envs.tasks.person_numbers import SKIN

PROGRAM_VERSION = 5  # goes up when the same row acts otherwise in the same situation
FAMILIES = ("spring", "muscle", "stepper")  # forms of the controller; no robot trains with the last
ROWS = 10_000  # rows of numbers, the same for each family
COUNT = ROWS * len(FAMILIES)  # persons: those of a family follow each other
INNER = 8_000  # rows inside 80% of every axis; from here to ROWS: corners
BEYOND = 10  # of a corner's axes at least lie beyond it, or all of its wishes: of 30 a point of the
# whole cube has 6 there on average
BITS = 30  # of a coordinate
SIDES = ("training", "validation", "test")
UNSEEN = "stepper"  # the family that no robot trains with
# Groups of the test side, which count the same in M_test.
KNOWN_FAMILIES, UNSEEN_FAMILY = "known families", "unseen family"
OWN_FAMILY = "organiser's family"  # of a season whose organiser brought one
TEAMS = "teams"  # trained policies, where persons play too
OWN_PREFIX = "own-"  # of a family's name that an installed package adds, see `installed_family`


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


def marked(rows: np.ndarray, families: Sequence[int] | np.ndarray | int = 0) -> np.ndarray:
    """Return rows [P, 31] as `PersonPlayer` takes them: `rows` [P, 30], then the family's place.

    `families` are places among `FAMILIES`, [P] or one of all.
    """
    column = np.broadcast_to(np.asarray(families, np.float32), len(rows))
    return np.concatenate([np.asarray(rows, np.float32), column[:, None]], axis=1)


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
    family: str  # one of FAMILIES, or one of a package
    row: np.ndarray  # [30] float32
    files: str = ""  # sha256 of the package's files

    @property
    def own(self) -> str:
        """Return the name of the package's family; empty for one of FAMILIES."""
        return self.family.removeprefix(OWN_PREFIX) if self.family not in FAMILIES else ""

    @property
    def name(self) -> str:
        """Return its name in the registry."""
        return f"person-{self.number:05d}"

    @property
    def identity(self) -> str:
        """Return the SHA-256 of the program's version, the family, the task and the row.

        Of a package's family, the sha256 of its files belongs to it.
        """
        family = " ".join(filter(None, (self.family, self.files)))
        head = f"person program {PROGRAM_VERSION} {family} {self.task}\n"
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


def family_place(family: str) -> int:
    """Return a family's place among FAMILIES; that of springs for a package's own program."""
    return FAMILIES.index(family) if family in FAMILIES else 0


def group_of(algorithm: str) -> str:
    """Return a partner's group on the test side, by its family or by how its team was trained."""
    if algorithm.startswith(OWN_PREFIX):
        return OWN_FAMILY
    if algorithm not in FAMILIES:
        return TEAMS
    return UNSEEN_FAMILY if algorithm == UNSEEN else KNOWN_FAMILIES


def groups_of(algorithms: Sequence[str]) -> tuple[str, ...] | None:
    """Return the group of each partner [P], see `group_of`; None unless persons play."""
    if not set(algorithms) & set(FAMILIES):
        return None
    return tuple(map(group_of, algorithms))


def installed_family(name: str) -> Extension:
    """Return the entry point of a package's family, which nothing imports here.

    Raises:
        ValueError: No installed package names such a family.
        ExtensionError: A name of the group is malformed, taken, or that of two packages.
    """
    found = extensions(ADDED, taken=FAMILIES)
    if name not in found:
        raise ValueError(
            f"family {name!r} is none of an installed package; installed are "
            f"{', '.join(found) or 'none'}: install the package that names it in {ADDED}"
        )
    return found[name]


def check_files(name: str, digest: str) -> Extension:
    """Return the entry point of a package's family, after comparing its files with a sha256.

    Whatever is received names a family and its files' sha256 alone; it never brings code.

    Raises:
        ValueError: The package is missing, or has other files; nothing was imported.
    """
    extension = installed_family(name)
    here = files_sha256(extension.files())
    if here != digest:
        raise ValueError(
            f"the family {name!r} has files of sha256 {digest}, and the installed package "
            f"{extension.package} {extension.version} has files of sha256 {here}; install the "
            "package with these very files"
        )
    return extension


@functools.cache
def persons(task: str) -> np.ndarray:
    """Return the rows of a task's persons, [10000, 30] float32, read-only.

    Person n has row n modulo 10,000: each family has a person with each row.

    Raises:
        ValueError: there is no such task.
    """
    person_kind(task)
    sources = [Path(path).read_bytes() for path in (__file__, inspect.getfile(Parameter))]
    key = compiled.key([task.encode(), repr(PARAMETERS[task]).encode(), *sources])
    try:  # to take what this user has made, since making takes two seconds
        kept = compiled.cached(key, ".npy", lambda path: np.save(path, made_rows(task)))
        table = np.load(kept, allow_pickle=False)
    except (OSError, ValueError):
        table = made_rows(task)
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
    """Return rows [count, 30] of a secret's persons.

    `hidden_family` gives their families. Of five persons two are corners, two are of the unseen
    family from anywhere in the cube, and one lies inside, as those of the training side. The same
    secret gives the same rows: a season's hidden persons need no storage.
    """
    person_kind(task)
    points = [_hidden_point(task, secret, place) for place in range(count)]
    return _rows(task, np.reshape(points, (count, WIDTH)))


def hidden_family(place: int) -> str:
    """Return the family of a secret's person, by its place in the draw."""
    known = [name for name in FAMILIES if name != UNSEEN]
    return (known[0], UNSEEN, known[1], UNSEEN, known[place // 5 % 2])[place % 5]


def _hidden_point(task: str, secret: bytes, place: int) -> np.ndarray:
    """Return the point [30] of a secret's person: a corner, inside, or anywhere in the cube."""
    name = f"person {place} of {task} from ".encode() + secret
    if hidden_family(place) == UNSEEN:
        return _stream_points(name, 1)[0]
    if place % 5 == 4:
        return 0.1 + 0.8 * _stream_points(name, 1)[0]
    count = 32  # of 11 points about one is a corner
    while not (corner := _corners(task, points := _stream_points(name, count))).any():
        count *= 2
    return points[corner.argmax()]


def _stream_points(name: bytes, count: int) -> np.ndarray:
    """Return the first points [count, 30] of the cube that a name gives."""
    stream = hashlib.shake_256(name).digest(8 * WIDTH * count)
    shares = (np.frombuffer(stream, "<u8") >> 11).astype(np.float64) / 2.0**53
    return shares.reshape(count, WIDTH)


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


def made_rows(task: str) -> np.ndarray:
    """Return the rows [10000, 30] of a task, made anew."""
    return _rows(task, _points(task))


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
    begin = 2**14  # corners come from what follows, all others from before it
    corners = points[begin:][_corners(task, points[begin:])]
    return np.concatenate([0.1 + 0.8 * points[:INNER], corners[: ROWS - INNER]])


def _corners(task: str, points: np.ndarray) -> np.ndarray:
    """Return whether points [P, 30] of the cube are corners."""
    beyond = np.abs(points - 0.5) > 0.4
    wishes = [place for name, place in index(task).items() if name.startswith("liked_")]
    return (beyond.sum(axis=1) >= BEYOND) | beyond[:, wishes].all(axis=1)


# Clinicians' scales: what stands beside a number on a card. The steps are ours (design).
MRC = ((0.1, "3"), (0.35, "4-"), (0.6, "4"), (0.85, "4+"), (1.01, "5"))  # of a healthy arm
ASHWORTH = ((0.01, "0"), (0.8, "1"), (1.6, "1+"), (3.0, "2"), (9.0, "3"))  # N m s/rad


def grade(scale: tuple[tuple[float, str], ...], value: float) -> str:
    """Return the first grade of a scale whose bound lies above `value`."""
    return next(name for bound, name in scale if value < bound)
