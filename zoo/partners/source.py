"""A kind of partner: all that a registry asks of it, with defaults that most kinds share.

Teams and persons are kinds. An installed package adds one by an entry point of the group
`assistax_zoo.partners` that names a subclass of `PartnerSource`.
"""

import dataclasses
import functools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from assistax_base.digest import sha256
from assistax_base.errors import UnknownIdError, counted
from zoo.partners.sides import DEFAULT_SIDE, SIDES
from zoo.schema import PolicyEntry, Split, Training

if TYPE_CHECKING:
    from assistax_envs.disability import Disability
    from population.networks.stack import PolicyStack
    from zoo.registry import Registry


class PartnerSource:
    """Partners of one kind, as a registry has them.

    A subclass sets `word` and implements `owns`, `select`, `split` and `stacks`. The spec of its
    stacks is a `population.networks.seat.SeatSpec`, whose `humans` gives bodies and preferences.

    Attributes:
        word: Names the kind where partners or a split are chosen, such as "persons", and is the
            rule of its splits. Empty for teams, which are chosen by their ids.
        own_preferences: Whether its partners bring preferences of their own.
        drawn: Whether each episode of a training draws a person, by the "row" of its parameters.
            If false, every partner has an equal share of the simulations.
        most: How many of a side play if no number is asked for. None for all.
        with_teams: Whether teams may play beside its partners.
        without_bytes: Why a partner has no bytes to export.
        pinned: Why a lock cannot pin a partner.
        has_numbers: Whether `numbers` describes its partners.
    """

    word: ClassVar[str]
    own_preferences: ClassVar[bool] = False
    drawn: ClassVar[bool] = False
    most: ClassVar[int | None] = None
    with_teams: ClassVar[bool] = False
    without_bytes: ClassVar[str] = "a partner that a package makes"
    pinned: ClassVar[str] = "which a package makes"
    has_numbers: ClassVar[bool] = False

    def __init__(self, registry: "Registry") -> None:
        self.registry = registry

    @classmethod
    def owns(cls, name: str) -> bool:
        """Return whether an id, or a glob over ids, is of this kind."""
        raise NotImplementedError

    def select(self, patterns: Sequence[str]) -> list[PolicyEntry]:
        """Return the entries whose id or team matches one of the globs; empty if none does.

        Raises:
            UnknownIdError: An id has what no partner of the kind can have; the error says what is
                allowed.
        """
        raise NotImplementedError

    def split(self, task: str, name: str | None, release: str | None = None) -> Split | None:
        """Return a split of this kind.

        Args:
            task: Task of the split.
            name: Its id or the beginning of it; None for the default split.
            release: Of whose partners it is; None for any release.

        Returns:
            None if the name is no split of this kind, or if there is no default split.

        Raises:
            SplitError: The name is one of this kind, and there is no such split.
        """
        raise NotImplementedError

    def stacks(self, entries: Sequence[PolicyEntry]) -> "tuple[PolicyStack, ...]":
        """Return the parameters of entries, one stack for each spec, verified."""
        raise NotImplementedError

    def candidates(self, patterns: Sequence[str]) -> list[PolicyEntry]:
        """Return the entries among which globs are looked up; for errors too."""
        return self.select(patterns)

    def known(self, ids: Iterable[str]) -> list[PolicyEntry]:
        """Return the entries of policy ids, in the order of the ids; unknown ids are skipped."""
        wanted = list(ids)
        found = {entry.id: entry for entry in self.select(wanted)}
        return [found[name] for name in wanted if name in found]

    @classmethod
    def names_split(cls, text: str) -> bool:
        """Return whether a split that a user names is one of this kind."""
        return bool(re.search(rf"(^|[:/]){re.escape(cls.word)}($|[:-])", text))

    def choose(
        self,
        task: str,
        split: str | None,
        patterns: str | Sequence[str] | None,
        most: int | None = None,
    ) -> tuple[Split, list[PolicyEntry]]:
        """Return a split, and the entries of one of its sides that are to play.

        Args:
            task: Task of the partners.
            split: A split's id or the beginning of it, a side, or both, as "persons:validation".
                The default side is the test side; of globs it is both.
            patterns: The kind's `word`, globs over its partners, and over teams of the side that
                are to play beside them. Without any, teams of the side play too: as many as
                partners of a group do, or all.
            most: How many partners of this kind. They are a draw of those that match, with equal
                shares of the groups; a smaller draw is a part of a larger one.

        Raises:
            ValueError: There is no such split or side, or no team that matches is on the side.
            UnknownIdError: Fewer partners match.
        """
        texts = [patterns] if isinstance(patterns, str) else list(patterns or ())
        named = [self.registry.full(text) for text in texts if text != self.word]
        globs = [glob for glob in named if self._has(glob)]
        name, side = self._split_and_side(split, default="both" if globs else DEFAULT_SIDE)
        matching = {entry.team: entry.release for entry in self.select(globs)} if globs else {}
        releases = set(matching.values())
        release = releases.pop() if len(releases) == 1 else None
        if (dealt := self.split(task, name, release)) is None:
            raise ValueError(
                f"split {split!r} has no {self.word}; name {self.word}, or one of its sides"
            )
        on_side = [team for part in SIDES[side] for team in getattr(dealt, part)]
        wanted = [team for team in on_side if self._has(team) and (not globs or team in matching)]
        if len(wanted) < (most or 1):
            raise UnknownIdError(
                f"{self.word} {', '.join(globs)}" if globs else f"{most} {self.word}",
                f"{self.word} on the {side} side of {dealt.id}",
                f"{len(wanted) or 'none'} that match",
                f"choose fewer, others, or another side: {', '.join(SIDES)}",
            )
        drawn = self._in_turn(wanted)[: self.most if most is None else most]
        teams = [team for team in on_side if not self._has(team)]
        if others := [glob for glob in named if glob not in globs]:
            drawn += self._teams(others, dealt, teams, side)
        elif not texts:
            sizes = Counter(map(self.group, drawn)).values()
            drawn += self._in_turn(teams)[: max(sizes, default=0)]
        return dealt, self.registry.known(sorted(f"{team}/human" for team in drawn))

    def _has(self, name: str) -> bool:
        """Return whether an id or a glob is of this kind, not of teams beside it."""
        return self.registry.source_of(name).word == self.word

    def _teams(
        self, globs: Sequence[str], split: Split, on_side: Sequence[str], side: str
    ) -> list[str]:
        """Return the teams of a split's side that match one of the globs."""
        matching = []
        if on_side:
            matching = self.registry.select(globs, task=split.task, role="human")
        if not (found := [entry.team for entry in matching if entry.team in {*on_side}]):
            found = f"{counted(len(on_side), 'team')}, and {', '.join(globs)} matches none of them"
            raise ValueError(
                f"the {' or '.join(SIDES[side])} side of split {split.id} has "
                f"{found if on_side else 'no teams'}; choose teams of that side, or {self.word} "
                "alone"
            )
        return found

    def group(self, team: str) -> str:
        """Return the group of a partner, of which a draw has as many as of the other groups."""
        return ""

    def _in_turn(self, teams: Sequence[str]) -> list[str]:
        """Return partners in the order of the draw: random within a group, groups in turn."""
        taken: Counter[str] = Counter()
        places = {}
        for team in sorted(teams, key=lambda team: sha256(team.encode())):
            group = self.group(team)
            places[team] = (taken[group], group)
            taken[group] += 1
        return sorted(places, key=places.__getitem__)

    def _split_and_side(self, text: str | None, default: str) -> tuple[str, str]:
        """Return the name of a split and a side of it, as a user names them."""
        name, _, side = (text or "").rpartition(":")
        if side not in SIDES:
            name, side = text or "", default
        return name or self.word, side

    def identities(self, split: Split) -> dict[str, str | None]:
        """Return the sha256 of each partner of a split's training side, by team."""
        entries = self.known(f"{team}/human" for team in split.train)
        return {entry.team: entry.sha256 for entry in entries}

    def validation(self, split: Split) -> str | None:
        """Return the name of a split's validation side, as `choose` takes it; None without one."""
        return f"{split.id}:validation" if split.validation else None

    def offered(self, task: str, release: str) -> str | None:
        """Return which partners of a release a user can choose for a task, in words, if any."""
        return None

    def public(self, task: str, split: Split) -> list[PolicyEntry]:
        """Return the humans of a task that a list of partners shows: those that play by default."""
        return self.choose(task, None, None)[1]

    def alone(self, split: Split) -> Split:
        """Return the split of the same partners of this kind, without teams beside them.

        By it a robot that trains with its training side is recorded.
        """
        return split

    def teams_of(self, split: Split) -> Sequence[str]:
        """Return the teams of the registry that decide a split, which a lock has to pin."""
        return ()

    def card(self, entry: PolicyEntry) -> dict[str, Any]:
        """Return all that is known of a partner, JSON-ready."""
        setting = dataclasses.asdict(entry.setting) if entry.setting else {}
        return {
            "id": entry.id,
            "team": entry.team,
            "release": entry.release,
            "disability": {"setting": entry.disability, **setting},
            "spec": entry.spec.to_json(),
            "self_play": None,
            "training": entry.training.model_dump(mode="json"),
            "splits": {},
            "sha256": entry.sha256,
        }

    def leaves(self, entry: PolicyEntry) -> set[str]:
        """Return the names of the leaves of a release's tree that only this kind has."""
        return set()

    def split_leaves(self, task: str) -> set[str]:
        """Return the names of the leaves of a release's tree that a split of its partners needs."""
        return set()

    def table_sizes(self) -> list[int]:
        """Return the sizes of the tables of partners that the registry's releases name."""
        return []

    def problems(self) -> Iterator[str]:
        """Yield the problems of the registry's records of this kind."""
        yield from ()

    def settings(self, split: Split) -> list[list[Any]]:
        """Return id and disability setting of each partner of a split's training side."""
        entries = self.known(f"{team}/human" for team in split.train)
        return [[entry.id, dataclasses.astuple(entry.partner_setting)] for entry in entries]

    @classmethod
    def numbers(cls, names: Sequence[str]) -> Any:
        """Return task and numbers of those partners that `names` lists; see `Persons.numbers`."""
        raise NotImplementedError


def made_entry(
    spec: Any,
    task: str,
    team: str,
    *,
    algorithm: str,
    number: int,
    digest: str,
    env_version: int,
    setting: "Disability",
    disability: str = "own",
    release: str = "",
) -> PolicyEntry:
    """Return the entry of a partner of which nothing is stored.

    Args:
        spec: Its seat, a `population.networks.seat.SeatSpec`.
        task: Task that it plays.
        team: Its id without the role, such as "gentle_scratch/person-00042-v1".
        algorithm: Name of its family, by which tables group partners.
        number: Its number within its kind.
        digest: sha256 of all that decides how it acts: results are kept by it.
        env_version: Version of the task's environment in which it acts.
        setting: Its body.
        disability: Name of its body in tables.
        release: Release of the registry that it belongs to; empty if it is of none.
    """
    return PolicyEntry(
        id=f"{team}/human",
        team=team,
        task=task,
        algorithm=algorithm,
        role="human",
        disability=disability,
        setting=setting,
        seed=number,
        release=release,
        spec=spec,
        shard="",
        row=number,
        sha256=digest,
        run="",
        training=_untrained(env_version),
        self_play=None,
    )


@functools.cache
def _untrained(version: int) -> Training:
    return Training(steps=0, env_version=version, backend="none")
