"""Partners that a published robot met in training, and which are not new to it.

A team's robot learned with its own human. An ego was trained with frozen humans, those of a split's
training side. Humans are told apart by the sha256 of their parameters, so that a human that was
published under two ids is one human. `zoo.met.claims` reads what others claim of their robots.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import Field

from assistax_base.digest import json_sha256
from assistax_base.errors import SplitError, shorten
from zoo.namespaces import plain_name, split_namespace
from zoo.partners.teams import Humans, humans_of
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split, StrictModel, Team, TrainedAgainst


class Met(StrictModel):
    """Partners that a robot met in training, and the source of this knowledge."""

    source: Literal["registry", "file", "declared", "not known"]
    own: Humans = Field(default={})  # humans that learned together with it
    partners: Humans = Field(default={})  # frozen humans that it was trained with
    split: TrainedAgainst | None = None  # split of which they are the training side
    reason: str = ""  # why nothing is known

    @property
    def known(self) -> bool:
        """Whether the partners are known."""
        return self.source != "not known"

    @property
    def claim(self) -> dict[str, Any]:
        """The claim for a file of the robot, JSON-ready; empty if nothing is known."""
        if not self.known:
            return {}
        fields = set(CLAIMED)
        if self.split is not None and len(self.partners) > MOST_NAMED:
            fields -= {"partners"}  # a reader takes them from the split
        return {"met": self.model_dump(mode="json", include=fields, exclude_none=True)}


NOT_KNOWN = Met(source="not known")
MOST_NAMED = 1000  # partners that a file names one by one
CLAIMED = ("own", "partners", "split")


def met_in_training(registry: Registry, robot: PolicyEntry) -> Met:
    """Return the partners that a published robot met, by the registry.

    Args:
        registry: Has the robot; an ego's split may be of any zoo that was added to it.
        robot: A team's robot, or an ego.
    """
    namespace = split_namespace(robot.team)[0]
    against = robot.trained_against
    if against is None:
        teams = registry.part(namespace).data.teams
        return Met(source="registry", own=humans_of(teams, [robot.team], namespace))
    if (made := made_split_met(registry, against)) is not None:
        return made
    named = [
        (place, teams, split)
        for place, teams, split in _published_splits(registry, namespace)
        if split.id == plain_name(against.split)
    ]
    for place, teams, split in named:
        if against.sha256 == split.sha256 == json_sha256(split.content):
            names = [f"{place}:{team}" if place else team for team in split.train]
            partners = humans_of(teams, names, place)
            return Met(source="registry", partners=partners, split=against)
    problem = "has another sha256 in this registry" if named else "is not in this registry"
    reason = f"split {shorten(against.split)}, the split of its training, {problem}"
    return Met(source="not known", split=against, reason=reason)


def made_split_met(registry: Registry, against: TrainedAgainst) -> Met | None:
    """Return the partners of a robot that trained with a split which a kind of partner makes.

    Returns:
        None if no kind makes that split, or if its content is now another.
    """
    task = plain_name(against.split).partition("/")[0]
    for source in registry.sources[1:]:
        try:
            made = source.split(task, against.split)
        except SplitError:
            continue
        if made and made.sha256 == against.sha256:
            return Met(source="registry", partners=source.identities(made), split=against)
    return None


def _published_splits(
    registry: Registry, first: str
) -> Iterator[tuple[str, Mapping[str, Team], Split]]:
    """Yield namespace, teams and split for each split of each zoo; the zoo `first` comes first."""
    for namespace in dict.fromkeys([first, *registry.parts]):
        data = registry.part(namespace).data
        for split in data.splits:
            yield namespace, data.teams, split
    for split in registry.splits:
        yield "", registry.data.teams, split
