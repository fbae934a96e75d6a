"""Persons: partners that are rows of numbers, which a formula gives. See `person_tables`."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from assistax_base.errors import ZooError
from zoo.history.merkle import persons_leaf
from zoo.partners.person_ids import PERSONS, is_team, parse_person
from zoo.partners.source import PartnerSource
from zoo.schema import PolicyEntry, Split

if TYPE_CHECKING:
    import numpy as np

    from population.networks.stack import PolicyStack

_SPLIT = re.compile(rf"{PERSONS}(-|$)")


class Persons(PartnerSource):
    """The persons that the registry's releases name."""

    word = PERSONS
    own_preferences = drawn = True
    most = 200  # a command then takes minutes
    with_teams = True
    without_bytes = "a person, who is a program and its numbers"
    pinned = "which the release's root pins"
    has_numbers = True

    @classmethod
    def owns(cls, name: str) -> bool:
        """Return whether an id or a glob says "person"."""
        return not is_team(name)

    @classmethod
    def names_split(cls, text: str) -> bool:
        """Return whether a split's name speaks of persons."""
        return PERSONS in text

    def select(self, patterns: Sequence[str]) -> list[PolicyEntry]:
        """Return the entries of all persons that match one of the globs, in their order.

        Raises:
            UnknownIdError: An id has a number that no person has.
        """
        from zoo.partners.person_tables import check_number, select_persons

        for name in patterns:
            check_number(self.registry.data, name)
        return select_persons(self.registry.data, patterns)

    def known(self, ids: Iterable[str]) -> list[PolicyEntry]:
        """Return the entries of persons by their policy ids; unknown ids are skipped."""
        from zoo.partners.person_tables import find_person

        found = (find_person(self.registry.data, name) for name in ids if name.endswith("/human"))
        return [entry for entry in found if entry]

    def split(self, task: str, name: str | None, release: str | None = None) -> Split | None:
        """Return a split of persons; see `PartnerSource.split`."""
        data = self.registry.data
        if name is None:
            named = data.releases.get(release or "")
            if named is None or task not in named.persons:
                return None
            name = PERSONS
        if not _SPLIT.match(name.rpartition(":")[2].removeprefix(f"{task}/")):
            return None
        if release and name == PERSONS:
            # That of their own release, which may not be the newest.
            namespace, colon, plain = release.rpartition(":")
            name = f"{namespace}{colon}{name}-s0-{plain}"
        from zoo.partners.person_tables import person_split

        return person_split(data, task, name)

    def stacks(self, entries: Sequence[PolicyEntry]) -> "tuple[PolicyStack[Any], ...]":
        """Return a stack of rows for each task and family, in the order of the entries."""
        from zoo.partners.person_tables import person_stacks

        return person_stacks(self.registry.data, entries)

    def group(self, team: str) -> str:
        """Return "known families", "unseen family" or "teams"; see `PartnerSource.group`."""
        from assistax_envs.persons.rows import TEAMS, group_of
        from zoo.partners.person_tables import family_of

        return group_of(family_of(self.registry.data, team)) if self._has(team) else TEAMS

    def identities(self, split: Split) -> dict[str, str | None]:
        """Return the sha256 of the training side, as the installed program makes persons."""
        from zoo.partners.person_tables import identities

        return identities(split.train) | self.registry.teams.identities(self._of_teams(split))

    def alone(self, split: Split) -> Split:
        """Return the split of the persons alone, which stays as it is when a release grows."""
        from zoo.partners.person_tables import persons_alone

        return persons_alone(split)

    def teams_of(self, split: Split) -> Sequence[str]:
        """Return the task's teams, of which the split has the competent ones, if it has any."""
        from zoo.partners.person_tables import beside_persons

        return beside_persons(self.registry.data, split)

    def offered(self, task: str, release: str) -> str | None:
        """Return how to choose the persons of a release, if it has any of the task."""
        from zoo.partners.person_tables import made_tables

        made = {name for name, _ in made_tables(self.registry.data, task)}
        return f"partners {PERSONS}" if release in made else None

    def card(self, entry: PolicyEntry) -> dict[str, Any]:
        """Return all that is known of a person, each number beside its range, JSON-ready."""
        from assistax_envs.persons.rows import described_numbers, grades
        from zoo.partners.person_tables import registered_person

        someone = registered_person(self.registry.data, entry)
        return {
            "id": entry.id,
            "team": entry.team,
            "release": entry.release,
            "side": someone.side,
            "family": someone.family,
            "spec": entry.spec.to_json(),
            "numbers": described_numbers(someone),
            "grades": grades(someone),
            "sha256": entry.sha256,
        }

    def leaves(self, entry: PolicyEntry) -> set[str]:
        """Return the name of the leaf of a task's table of persons."""
        return self.split_leaves(entry.task)

    def split_leaves(self, task: str) -> set[str]:
        """Return the name of the leaf of a task's table of persons."""
        return {persons_leaf(task)}

    def table_sizes(self) -> list[int]:
        """Return how many persons each table has that the installed program makes."""
        from assistax_envs.persons.rows import PROGRAM_VERSION
        from zoo.partners.person_tables import person_tables

        tables = (table for *_, table in person_tables(self.registry.data))
        return [table.count for table in tables if table.program == PROGRAM_VERSION]

    def problems(self) -> Iterator[str]:
        """Yield an error message for each table of persons that this program makes otherwise.

        Those of older programs cannot be made here, so nothing is said of them.
        """
        from assistax_envs.persons.rows import PROGRAM_VERSION
        from zoo.partners.person_tables import check_table, person_tables

        for named in person_tables(self.registry.data):
            if named[2].program < PROGRAM_VERSION:
                continue
            try:
                check_table(*named)
            except ZooError as error:
                yield str(error)

    def settings(self, split: Split) -> list[list[Any]]:
        """Return those of teams alone: a person's identity covers its body."""
        return self.registry.teams.settings(self._of_teams(split))

    def _of_teams(self, split: Split) -> Split:
        """Return a split with the teams alone on its training side."""
        teams = tuple(team for team in split.train if not self._has(team))
        return split.model_copy(update={"train": teams})

    @classmethod
    def numbers(cls, names: Sequence[str]) -> "tuple[str, list[bool], np.ndarray]":
        """Return task, which of the names are persons [P], and the numbers of those [Q, 30].

        Raises:
            ValueError: No name is a person's, they are of several tasks, or of a season's secret.
        """
        import numpy as np

        from assistax_envs.persons.rows import COUNT, ROWS, persons

        named = [parse_person(name) for name in names]
        tasks = {found[1] for found in named if found}
        if len(tasks) != 1:
            found = f"persons of {', '.join(sorted(tasks))}" if tasks else "no person"
            raise ValueError(
                f"{found} among its {len(names)} partners; evaluate robots with persons of one "
                "task, with partners 'persons'"
            )
        [task] = tasks
        numbers = [found[2] for found in named if found]
        if max(numbers) >= COUNT:
            raise ValueError(
                f"persons of a season's secret, such as number {max(numbers)}, and holds no rows "
                "of theirs; evaluate robots with the public persons, by partners 'persons'"
            )
        return task, [found is not None for found in named], persons(task)[np.array(numbers) % ROWS]
