"""Whom a robot met in training: the partners that are not new to it.

A team's robot learned with its own human. An ego was trained with frozen humans, those of a split's
training side. The registry says which; a file of a policy carries it as a claim of its own; of any
other robot its user declares it. Humans are told apart by the sha256 of their parameters, so that a
human that was published under two ids is one human.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from assistax_base.digest import json_sha256
from assistax_base.errors import IdError, shorten
from zoo.ids import parse_team
from zoo.namespaces import split_namespace
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Sha256, Split, StrictModel, Team, TrainedAgainst

NOBODY = "nobody"  # what is declared of a robot that met no partner of the zoo
Humans = dict[Annotated[str, Field(max_length=200)], Sha256 | None]  # team -> sha256 of its human


class Met(StrictModel):
    """Whom a robot met in training, and who says so."""

    source: Literal["registry", "file", "declared", "not known"]
    own: Humans = Field(default={})  # humans that learned together with it
    partners: Humans = Field(default={})  # frozen humans that it was trained with
    split: TrainedAgainst | None = None  # whose training side these are
    reason: str = ""  # why nothing is known

    @property
    def known(self) -> bool:
        """Whether anybody says it."""
        return self.source != "not known"

    @property
    def claim(self) -> dict[str, Any]:
        """What a file of the robot says, JSON-ready; empty where nothing is known."""
        if not self.known:
            return {}
        return {"met": self.model_dump(mode="json", include=set(_CLAIMED), exclude_none=True)}


NOT_KNOWN = Met(source="not known")
_CLAIMED = ("own", "partners", "split")


def met_in_training(registry: Registry, robot: PolicyEntry) -> Met:
    """Return whom a published robot met, as the registry has it.

    Args:
        registry: Has the robot; an ego's split may be of any zoo that was added to it.
        robot: A team's robot, or an ego.
    """
    namespace = split_namespace(robot.team)[0]
    against = robot.trained_against
    if against is None:
        teams = registry.part(namespace).data.teams
        return Met(source="registry", own=_humans(teams, [robot.team], namespace))
    named = [
        (place, teams, split)
        for place, teams, split in _published_splits(registry, namespace)
        if split.id == split_namespace(against.split)[1]
    ]
    for place, teams, split in named:
        if against.sha256 == split.sha256 == json_sha256(split.content):
            names = [f"{place}:{team}" if place else team for team in split.train]
            partners = _humans(teams, names, place)
            return Met(source="registry", partners=partners, split=against)
    problem = "has another sha256 in this registry" if named else "is not in this registry"
    reason = f"split {shorten(against.split)}, with whose training side it was trained, {problem}"
    return Met(source="not known", split=against, reason=reason)


def side_met(registry: Registry, split: Split) -> Met:
    """Return what a robot met that was trained with a split's training side."""
    partners = _humans(registry.data.teams, split.train)
    against = TrainedAgainst(split=split.id, sha256=split.sha256)
    return Met(source="registry", partners=partners, split=against)


def claimed_met(registry: Registry, metadata: Mapping[str, Any]) -> Met:
    """Return whom a robot met as its file claims; whoever wrote the file may have said anything.

    Files that were written before they carried it name the policy that they are of, or the split.
    """
    if "met" in metadata:
        claim = metadata["met"]
        if not isinstance(claim, Mapping) or set(claim) - set(_CLAIMED):
            return Met(source="not known", reason="its file does not say it in a known form")
        try:
            return Met.model_validate({"source": "file", **claim})
        except ValidationError:
            return Met(source="not known", reason="its file does not say it in a known form")
    named = metadata.get("id"), metadata.get("sha256")
    for entry in registry.policies:
        if (entry.id, entry.sha256) == named and entry.role == "robot":
            found = met_in_training(registry, entry)
            return found.model_copy(update={"source": "file"}) if found.known else found
    for split in registry.splits if "split" in metadata else ():
        if split.id == metadata["split"]:
            return side_met(registry, split).model_copy(update={"source": "file"})
    return Met(source="not known", reason="its file does not say it")


def declared_met(registry: Registry, task: str, trained_with: str | Sequence[str]) -> Met:
    """Return whom a robot met as its user declares.

    Args:
        registry: Where the partners are looked up.
        task: Whose partners.
        trained_with: "nobody"; or split ids, each for its training side, and globs over partners or
            teams.

    Raises:
        ValueError: It is no text and no list of texts, or "nobody" stands beside others.
        ZooError: There is no such split, or no partner matches.
    """
    names = [trained_with] if isinstance(trained_with, str) else list(trained_with)
    if not names or not all(isinstance(name, str) for name in names):
        raise ValueError(
            f"trained_with is {shorten(trained_with)}; allowed are {NOBODY!r}, or split ids and "
            "globs over partners"
        )
    if names == [NOBODY]:
        return Met(source="declared")
    if NOBODY in names:
        raise ValueError(f"trained_with has {NOBODY!r} beside others; leave one of them out")
    partners: Humans = {}
    splits = []
    for name in names:
        if _names_teams(name):
            chosen = registry.select(name, task=task, role="human")
            partners |= {entry.team: entry.sha256 for entry in chosen}
        else:
            splits.append(registry.split(task, name))
            partners |= _humans(registry.data.teams, splits[-1].train)
    one = splits[0] if len(splits) == len(names) == 1 else None
    against = TrainedAgainst(split=one.id, sha256=one.sha256) if one else None
    return Met(source="declared", partners=partners, split=against)


def known_humans(entries: Iterable[PolicyEntry], humans: Humans) -> frozenset[str]:
    """Return the ids of the entries, humans all, that are among those a robot met."""
    digests = set(humans.values())
    return frozenset(one.id for one in entries if one.team in humans or one.sha256 in digests)


def _published_splits(
    registry: Registry, first: str
) -> Iterator[tuple[str, Mapping[str, Team], Split]]:
    """Yield namespace, teams and split of each zoo, one zoo's before all others'."""
    for namespace in dict.fromkeys([first, *registry.parts]):
        data = registry.part(namespace).data
        for split in data.splits:
            yield namespace, data.teams, split
    for split in registry.splits:
        yield "", registry.data.teams, split


def _humans(teams: Mapping[str, Team], names: Iterable[str], namespace: str = "") -> Humans:
    """Return the sha256 of each team's human; None where the zoo has none."""
    humans: Humans = {}
    for name in names:
        team = teams.get(name) or teams.get(name.removeprefix(f"{namespace}:"))
        human = team.policies.get("human") if team else None
        humans[name] = human.sha256 if human else None
    return humans


def _names_teams(text: str) -> bool:
    """Return whether a text is a glob, or the id of a team or a policy, and no split's."""
    if set(text) & set("*?["):
        return True
    try:
        parse_team(text.removesuffix("/human").removesuffix("/robot"))
    except IdError:
        return False
    return True
