"""Describes a season's task and partners in words, for labs and readers.

How many of which kind are hidden is public; who they are is not.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from assistax_envs.persons.rows import OWN_PREFIX

if TYPE_CHECKING:
    from zoo.registry import Registry
    from zoo.schema import PolicyEntry

NOT_PEOPLE = (
    "They are not validated models of people: a place on this board says nothing about safety or "
    "benefit for a person."
)
TRAINED = "trained policies"
OF_OWN_FAMILY = "of a family of the organiser's"  # which one is secret until it closes
MADE = "persons made of numbers, who were trained with no robot"


def describe_partners(registry: "Registry", entries: Sequence["PolicyEntry"]) -> dict[str, Any]:
    """Return the public description of partners: counts by kind and environment version."""

    def count(own_preferences: bool) -> dict[str, int]:
        kinds = Counter(
            OF_OWN_FAMILY if e.algorithm.startswith(OWN_PREFIX) else e.algorithm
            for e in entries
            if e.spec.own_preferences is own_preferences
        )
        return dict(sorted(kinds.items()))

    versions = {registry.env_version(entry) for entry in entries}
    return {"env_versions": sorted(versions), "persons": count(True), "teams": count(False)}


def partners_in_words(played: Mapping[str, Any] | None) -> str:
    """Return partners in words, as "200 persons (100 muscle, 100 spring), environment version 3".

    A season that was made before this was recorded says so.
    """
    if not played:
        return "kinds not recorded"
    names = {"persons": "persons", "teams": "partners of trained teams"}
    parts = [
        f"{sum(played[kind].values())} {name} "
        f"({', '.join(f'{count} {what}' for what, count in played[kind].items())})"
        for kind, name in names.items()
        if played[kind]
    ]
    return f"{' and '.join(parts)}, {in_version(played['env_versions'])}"


def plays_in_words(hidden: Mapping[str, Any] | None, public: int | None) -> str:
    """Return a season's task and partners in one line."""
    versions = [] if public is None else [public]
    return f"public half: {in_version(versions)}; hidden: {partners_in_words(hidden)}"


def in_version(versions: Sequence[int]) -> str:
    """Return versions of the environment in words."""
    numbers = " and ".join(map(str, versions)) or "not known"
    return f"environment version{'s' if len(versions) > 1 else ''} {numbers}"


def statement_of(hidden: Mapping[str, Any] | None) -> str:
    """Return a statement about the nature of a season's partners."""
    who = "All partners are simulated"
    if hidden:
        kinds = [words for kind, words in (("teams", TRAINED), ("persons", MADE)) if hidden[kind]]
        who = f"{who}; hidden ones are {' and '.join(kinds)}"
    return f"{who}. {NOT_PEOPLE}"


def warning_of(said: int | None, public: int | None, season: Any | None) -> str | None:
    """Return a warning for a robot that was trained in another version than one that is played.

    Args:
        said: The version that the robot's file says, if it says any.
        public: The version of the public half.
        season: Row of its season, if it takes part in one.
    """
    played = {"the public half": [] if public is None else [public]}
    if season is not None and season.hidden:
        played[f"the hidden panels of season {season.name}"] = season.hidden["env_versions"]
    others = [
        f"{what} in {in_version(versions)}"
        for what, versions in played.items()
        if said is not None and set(versions) - {said}
    ]
    if not others:
        return None
    plays = " and ".join(others)
    return f"its file says that it was trained in {in_version([said or 0])}; it plays {plays}"
