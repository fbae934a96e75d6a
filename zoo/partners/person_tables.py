"""The persons that a registry's releases name: found by id or glob, their table held to its sha256.

A release names for each task the program, how many persons there are, and the sha256 of the table
of their rows. Nothing is stored of a person: the formula gives the same rows everywhere. A season's
private release names a secret beside, from which other rows follow: its persons have the numbers
after the public ones, so that no id is of two persons.

A release may hold persons of another version of the program. It is read, but nobody makes these
persons: they have no splits here, and an error says which program is installed.
"""

import functools
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from assistax_base.digest import sha256
from assistax_base.errors import (
    IntegrityError,
    RegistryVersionError,
    SplitError,
    UnknownIdError,
    shorten,
)
from assistax_envs.disability import Disability
from assistax_envs.persons.rows import (
    COUNT,
    FAMILIES,
    OWN_PREFIX,
    PROGRAM_VERSION,
    ROWS,
    SIDES,
    Person,
    drawn,
    family,
    family_place,
    hidden_family,
    index,
    marked,
    numbers,
    person,
    persons,
)
from population.networks.stack import PolicyStack
from zoo.ids import compile_pattern, parse_team
from zoo.namespaces import plain_name, qualify_split, split_namespace
from zoo.partners.person_ids import OWN, PERSON, PERSONS, is_team, parse_person
from zoo.partners.person_seat import PersonSpec
from zoo.partners.source import made_entry
from zoo.schema import Persons, PolicyEntry, RegistryFile, Split
from zoo.splits import competent, made_split, partner_teams


def person_tables(data: RegistryFile) -> Iterator[tuple[str, str, Persons]]:
    """Yield release, task and table of all persons, in the registry's order of releases."""
    for release, entry in data.releases.items():
        for task, table in entry.persons.items():
            yield release, task, table


def made_tables(data: RegistryFile, task: str) -> Iterator[tuple[str, Persons]]:
    """Yield release and table of a task's persons that the installed program makes."""
    for release, of, table in person_tables(data):
        if of == task and table.program == PROGRAM_VERSION:
            yield release, table


def person_glob(task: str, release: str) -> str:
    """Return the glob over all persons of a task in a release."""
    return _team(task, 0, release).replace("-00000-", "-*-") + "/human"


@functools.lru_cache(maxsize=16)
def described(task: str, secret: str | None = None, count: int = COUNT) -> Persons:
    """Return a release's record of a task's persons, or a secret's, as this program makes them."""
    digest = sha256(_rows(task, secret, count).astype("<f4").tobytes())
    return Persons(program=PROGRAM_VERSION, count=count, sha256=digest, secret=secret)


@functools.lru_cache(maxsize=16)
def _rows(task: str, secret: str | None, count: int) -> np.ndarray:
    return persons(task) if secret is None else drawn(task, bytes.fromhex(secret), count)


def registered_person(data: RegistryFile, entry: PolicyEntry) -> Person:
    """Return the person of an entry."""
    return _person(entry.task, entry.seed, data.releases[entry.release].persons[entry.task])


def _person(task: str, number: int, table: Persons) -> Person:
    if table.secret is None:
        return person(task, number)
    place = number - COUNT
    row = _rows(task, table.secret, table.count)[place]
    own = table.own
    if own is not None and place >= table.count - own.count:
        return Person(task, number, "test", f"{OWN_PREFIX}{own.name}", row, own.sha256)
    return Person(task, number, "test", hidden_family(place), row)


def family_of(data: RegistryFile, team: str) -> str:
    """Return the family of a person, by its id without a role."""
    named = parse_person(team)
    assert named is not None, team
    namespace, task, number, release = named
    if number < COUNT:
        return family(number)
    release = f"{namespace}:{release}" if namespace else release
    return _person(task, number, data.releases[release].persons[task]).family


def _numbers(table: Persons) -> range:
    """Return the numbers of a table's persons: a secret's come after the public ones."""
    first = 0 if table.secret is None else COUNT
    return range(first, first + table.count)


@functools.cache
def check_table(release: str, task: str, table: Persons) -> None:
    """Hold a release's persons of a task against those that the installed program makes.

    Raises:
        RegistryVersionError: The program is another one; nobody can play with these persons.
        IntegrityError: The rows are others.
    """
    here = described(task, table.secret, table.count if table.secret else COUNT)
    what = f"persons of {task} in release {release}"
    if table.program != here.program:
        raise RegistryVersionError(
            what,
            f"persons of program {here.program}, as installed",
            f"program {table.program}",
            next_step="install the assistax-zoo of this release",
        )
    if table.model_copy(update={"own": None}) != here:
        raise IntegrityError(
            what,
            f"{table.count} rows of sha256 {table.sha256}",
            f"{here.count} rows of sha256 {here.sha256}",
            "fetch the registry again from its publisher, or report that this machine makes other "
            "rows",
            "no person was loaded",
        )


def find_person(data: RegistryFile, policy: str) -> PolicyEntry | None:
    """Return the entry of one person by its id; None if the registry has no such person."""
    named = parse_person(policy)
    if named is None:
        return None
    namespace, task, number, release = named
    release = f"{namespace}:{release}" if namespace else release
    table = data.releases[release].persons.get(task) if release in data.releases else None
    if table is None or number not in _numbers(table):
        return None
    check_table(release, task, table)
    return _entry(data, release, _person(task, number, table))


def check_number(data: RegistryFile, name: str) -> None:
    """Raise an UnknownIdError if the number in a person's id is none of its release's persons."""
    place, _, rest = name.removesuffix("/human").partition(f"/{PERSON}-")
    digits, _, plain = rest.partition("-")
    namespace, _, task = place.rpartition(":")
    release = f"{namespace}:{plain}" if namespace else plain
    table = data.releases[release].persons.get(task) if release in data.releases else None
    if table is None or not digits.isdecimal():
        return
    numbers = _numbers(table)
    number = int(digits) if len(digits) <= 5 else None
    if len(digits) == 5 and number in numbers:
        return
    near = number if number in numbers else numbers.start
    allowed = f"{numbers.start:05d} to {numbers.stop - 1:05d}"
    if len(numbers) == COUNT:
        first = {family: place * ROWS for place, family in enumerate(FAMILIES)}
        of = (f"{n:05d} to {n + ROWS - 1:05d} {family}" for family, n in first.items())
        allowed += f" ({', '.join(of)})"
    raise UnknownIdError(
        f"unknown person {shorten(name)}",
        f"a number of five digits from {allowed}",
        shorten(digits),
        f"name another, such as {place}/{PERSON}-{near:05d}",
    )


def select_persons(data: RegistryFile, patterns: Sequence[str]) -> list[PolicyEntry]:
    """Return the entries of all persons that match one of several globs, in their order."""
    # Thousands of whole ids are looked up, so that they are not matched one by one.
    whole = {name.removesuffix("/human") for name in patterns if not set(name) & set("*?[")}
    globs = dict.fromkeys(name for name in patterns if set(name) & set("*?["))
    matches = [compile_pattern(glob).match for glob in globs]
    entries = []
    for release, task, table in person_tables(data):
        teams = {number: _team(task, number, release) for number in _numbers(table)}
        chosen = [
            number
            for number, team in teams.items()
            if team in whole or any(match(team) or match(f"{team}/human") for match in matches)
        ]
        if chosen:
            check_table(release, task, table)
        entries += [_entry(data, release, _person(task, number, table)) for number in chosen]
    return entries


def identities(teams: Iterable[str]) -> dict[str, str | None]:
    """Return the sha256 of persons by their ids without a role, as releases of today have them."""
    named = {team: parse_person(team) for team in teams}
    return {team: person(of[1], of[2]).identity for team, of in named.items() if of}


def person_stacks(
    data: RegistryFile, entries: Sequence[PolicyEntry]
) -> tuple[PolicyStack[Any], ...]:
    """Return a stack of rows for each task, in the order in which they first occur."""
    by_spec: dict[Any, list[PolicyEntry]] = {}
    for entry in entries:
        by_spec.setdefault(entry.spec, []).append(entry)
    return tuple(
        PolicyStack(spec, tuple(e.id for e in some), {"row": _marked(data, some)})
        for spec, some in by_spec.items()
    )


def _marked(data: RegistryFile, entries: Sequence[PolicyEntry]) -> np.ndarray:
    """Return the rows [P, 31] of persons as `assistax_envs.persons.rows.marked` has them."""
    people = [registered_person(data, entry) for entry in entries]
    places = [family_place(someone.family) for someone in people]
    return marked(np.stack([someone.row for someone in people]), places)


def person_splits(data: RegistryFile, task: str) -> Iterator[Split]:
    """Yield the splits of a task's persons, of which nothing is stored either.

    Each release has one, of three sides. If it has teams of the task, a second one has the
    competent teams too: those of each third seed, from seed 0, on its training side, the others on
    its test side. It follows the first unless that is the release's default. All persons of a
    secret are on the test side of one.
    """
    for release, table in made_tables(data, task):
        if table.secret is not None:
            yield _hidden_split(task, release, table.count)
            continue
        made, teams = [_split(task, release)], _teams(data, task, release)
        beside = tuple(sorted(plain_name(team) for team in competent(data, teams, {})))
        made += [_split(task, release, beside)] if beside else []
        default = data.releases[release].splits.get(task)
        yield from sorted(made, key=lambda split: split.id == default)


def beside_persons(data: RegistryFile, split: Split) -> list[str]:
    """Return the teams of which a split of persons has the competent ones, if it has any."""
    return _teams(data, split.task, split.release) if has_teams(split) else []


def persons_alone(split: Split) -> Split:
    """Return the split of the same persons without teams."""
    return _split(split.task, split.release) if has_teams(split) else split


def has_teams(split: Split) -> bool:
    """Return whether teams are on a side of a split of persons."""
    return any(map(is_team, (*split.train, *split.test)))


def _teams(data: RegistryFile, task: str, release: str) -> list[str]:
    namespace, plain = split_namespace(release)
    return partner_teams(data, f"{namespace}:{task}" if namespace else task, plain)


def person_split(data: RegistryFile, task: str, name: str) -> Split | None:
    """Return the split of persons with an id or its beginning; None for names of other splits.

    Raises:
        SplitError: The name is one of a split of persons, and there is no such split.
        RegistryVersionError: It may be one of persons of another program.
    """
    namespace, plain = split_namespace(name)
    plain = plain.removeprefix(f"{task}/")
    if not re.match(rf"{PERSONS}(-|$)", plain):
        return None
    known = list(person_splits(data, task))
    full = f"{namespace}:{task}/{plain}" if namespace else f"{task}/{plain}"
    matching = [split for split in known if f"{split.id}-".startswith(f"{full}-")]
    if not matching:
        for release, of, table in person_tables(data):
            if of == task and (not known or f"-{split_namespace(release)[1]}-" in f"{plain}-"):
                check_table(release, of, table)
        if not known:
            tasks = sorted({of for _, of, _ in person_tables(data)})
            expected = f"a task with persons ({', '.join(tasks)})" if tasks else "published persons"
            raise SplitError(f"split {name} of task {task}", expected, f"no persons of {task}")
        raise SplitError(
            f"split {name} of task {task}",
            f"one of {', '.join(split.id for split in known)}",
            "none of this name",
        )
    return matching[-1]  # of the newest release that has any


@functools.cache
def _split(task: str, release: str, teams: tuple[str, ...] = ()) -> Split:
    return _split_of(task, release, *(numbers(side).tolist() for side in SIDES), teams=teams)


@functools.cache
def _hidden_split(task: str, release: str, count: int) -> Split:
    return _split_of(task, release, (), (), range(COUNT, COUNT + count))


def _split_of(task: str, release: str, *sides: Sequence[int], teams: tuple[str, ...] = ()) -> Split:
    namespace, plain = split_namespace(release)
    train, validation, test = (tuple(_team(task, n, plain) for n in side) for side in sides)
    learned = [team for team in teams if parse_team(team).seed % 3 == 0]
    train = tuple(sorted((*learned, *train)))
    test = tuple(sorted((*(set(teams) - set(learned)), *test)))
    split = made_split(PERSONS, task, plain, train, test, validation=validation)
    return qualify_split(split, namespace) if namespace else split


def _entry(data: RegistryFile, release: str, someone: Person) -> PolicyEntry:
    return made_entry(
        PersonSpec(someone.task, own=someone.own, files=someone.files),
        someone.task,
        _team(someone.task, someone.number, release),
        algorithm=someone.family,
        number=someone.number,
        digest=someone.identity,
        env_version=data.releases[release].environments[someone.task],
        # A person's own program applies strength and tremor: `assistax_envs.persons.player`.
        setting=Disability(1.0, float(someone.row[index(someone.task)["range"]]), 0.0),
        disability=OWN,
        release=release,
    )


def _team(task: str, number: int, release: str) -> str:
    namespace, plain = split_namespace(release)
    return f"{namespace}{':' * bool(namespace)}{task}/{PERSON}-{number:05d}-{plain}"
