"""The published partners of a task, the filters of their list, and a partner's card."""

import dataclasses
from typing import Any

from assistax_board.pages.crossplays import CrossPlay
from zoo.registry import Registry
from zoo.schema import PolicyEntry

TRAITS = ("algorithm", "disability", "behaviour", "side")


@dataclasses.dataclass(frozen=True)
class PartnerCard:
    """A human of the zoo as a list shows it."""

    team: str  # "scratch/ippo-d3-s5-v1"
    algorithm: str
    disability: str
    behaviour: str | None  # letter of its cluster, None if nobody has played it
    side: str | None  # of the default split
    features: dict[str, Any]  # behaviour with its best robot
    entry: PolicyEntry

    @property
    def name(self) -> str:
        """The team's name within its task."""
        return self.team.partition("/")[2]


def list_partners(registry: Registry, task: str, crossplay: CrossPlay | None) -> list[PartnerCard]:
    """Return the humans of the task's default release; persons of the public half, if it has none.

    They stand in the registry's order.
    """
    split = registry.split(task)
    humans = registry.source_of_split(split).public(task, split)
    played = crossplay.humans if crossplay else {}
    return [_partner(entry, split.side(entry.team), played.get(entry.team)) for entry in humans]


def choices(partners: list[PartnerCard]) -> dict[str, list[str]]:
    """Return the choices of each filter."""
    return {
        trait: sorted(
            {value for partner in partners if (value := getattr(partner, trait)) is not None}
        )
        for trait in TRAITS
    }


def choose(partners: list[PartnerCard], traits: dict[str, str]) -> list[PartnerCard]:
    """Return the partners that match every filter; an empty filter matches all."""
    return [
        partner
        for partner in partners
        if all(not value or getattr(partner, trait) == value for trait, value in traits.items())
    ]


def _partner(entry: PolicyEntry, side: str | None, played: dict[str, Any] | None) -> PartnerCard:
    features = dict(played or {})
    cluster = features.pop("cluster", None)
    return PartnerCard(
        team=entry.team,
        algorithm=entry.algorithm,
        disability=entry.disability,
        behaviour=None if cluster is None else chr(ord("A") + cluster),
        side=side,
        features={name: value for name, value in features.items() if isinstance(value, float)},
        entry=entry,
    )
