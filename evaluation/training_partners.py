"""Partners of a robot's training: those of a split's training side."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from assistax_envs.versions import VERSIONS
from population.config import MIXED
from zoo.partners.kinds import kind_of
from zoo.registry import Registry
from zoo.schema import Split

if TYPE_CHECKING:
    from population.partners.frozen import FrozenPartners


def chosen_split(
    registry: Registry, task: str, split: str | Split | None, partners: str | None
) -> Split:
    """Return the split that gives the training partners; a split of persons for "persons".

    Of a default split that has teams beside persons it is that of the persons alone, but for
    "mixed".
    """
    words = [source.word for source in registry.sources if source.word]
    if partners == MIXED:
        chosen = split if isinstance(split, Split) else registry.split(task, split)
        if kind_of(chosen.train).word == registry.source_of_split(chosen).word:
            raise ValueError(
                f"partners are {MIXED!r}, and the training side of {chosen.id} has partners of one "
                f"kind; choose a split with teams beside others, or partners of {', '.join(words)}"
            )
        return chosen
    if isinstance(split, Split):
        return split
    if partners is not None and partners not in words:
        raise ValueError(
            f"partners are {partners!r}; allowed are {', '.join((*words, MIXED))}, or a split's "
            "alone"
        )
    chosen = registry.split(task, split or partners)
    if partners and chosen.rule != partners:
        raise ValueError(
            f"split {chosen.id} has no {partners}; leave out the split or the partners"
        )
    return registry.source_of_split(chosen).alone(chosen)


def older_version(registry: Registry, split: Split) -> int | None:
    """Return the environment version of a split's partners, or None if it is the newest."""
    from evaluation.cast.cast import env_version

    entries = registry.known(f"{team}/human" for team in split.train)
    version = env_version(registry, split.task, entries)
    return None if version == VERSIONS[split.task] else version


def load_partners(
    registry: Registry, split: Split, preferences: Sequence[str] = (), *, each: bool = False
) -> "FrozenPartners":
    """Return the partners of a split's training side; nothing of the test side is loaded.

    Args:
        registry: Where the partners are.
        split: Split whose training side is meant.
        preferences: Preferences of the humans.
        each: Give member i partner i alone.

    Raises:
        ValueError: Preferences are given, and the partners have their own; or `each` is asked for,
            and the partners are not drawn, or teams are beside them.
    """
    from population.partners.drawn_persons import DrawnPersons, OnePersonEach
    from population.partners.mixed import MixedPartners

    source = registry.source_of_split(split)
    if preferences and source.own_preferences:
        raise ValueError(
            f"preferences are {', '.join(preferences)}, but {source.word} have their own "
            "preferences; leave preferences out"
        )
    humans = {team: f"{team}/human" for team in split.train}
    if not source.drawn:
        if each:
            raise ValueError(f"{source.word or 'teams'} cannot be one partner of each member")
        return networks(registry, [*humans.values()])
    teams = [name for team, name in humans.items() if registry.source_of(team) is not source]
    if teams and each:
        raise ValueError(f"the training side of {split.id} has teams, which are not drawn")
    drawn = OnePersonEach if each else DrawnPersons
    [stack] = source.stacks(source.known(humans.values()))
    persons = drawn(stack.spec.player(), stack.params["row"], split.id)
    return MixedPartners(persons, networks(registry, teams)) if teams else persons


def networks(registry: Registry, humans: Sequence[str]) -> "FrozenPartners":
    """Return networks of one kind by their ids, with their parameters."""
    from population.partners.frozen import FrozenPartners, PartnersWithBodies

    entries = [registry.policy(name) for name in humans]
    settings = {entry.id: entry.partner_setting for entry in entries}
    kind = PartnersWithBodies if kind_of(humans).own_preferences else FrozenPartners
    return kind(registry.stacks(entries), settings)
