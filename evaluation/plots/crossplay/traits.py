"""Traits of policies as strips: the human's strength and range by lightness, algorithms by name."""

import dataclasses
from collections.abc import Iterable

from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.plots import style


@dataclasses.dataclass(frozen=True)
class Trait:
    """A trait of policies: its values by what a policy says, and the colours of the values.

    Attributes:
        name: Heading of the legend, and name of the strip.
        values: From an algorithm or a disability setting to the trait's value.
        colours: From a value, as the legend spells it, to its colour.
        of_algorithm: Whether the algorithm gives the value; else the disability setting does.
        ordinal: Whether the values are shares of what is left, from all to least.
    """

    name: str
    values: dict[str, str]
    colours: dict[str, str]
    of_algorithm: bool = False
    ordinal: bool = False

    def value(self, algorithm: str | None, disability: str | None) -> str | None:
        """Return the value of a policy; None if the policy has none."""
        return self.values.get((algorithm if self.of_algorithm else disability) or "")


def traits_of(algorithms: Iterable[str | None], disabilities: Iterable[str | None]) -> list[Trait]:
    """Return the traits that differ among policies, from the matrix outwards.

    Strength and range are shown of settings that have a meaning. Other settings are shown by name
    if there are several.
    """
    settings = {name for name in disabilities if name is not None}
    known = [name for name in DISABILITY_SETTINGS if name in settings]
    found = []
    if known:
        found.append(_level("strength", {n: DISABILITY_SETTINGS[n].strength for n in known}))
        found.append(_level("range", {n: DISABILITY_SETTINGS[n].elbow_range for n in known}))
    others = sorted(settings - set(known))
    if len(others) > 1:
        found.append(Trait("disability", {n: n for n in others}, style.disability_colours(others)))
    colours = style.algorithm_colours(algorithms)
    spelled = {name: style.spelled(name) for name in colours}
    named = {spelled[name]: colour for name, colour in colours.items()}
    return [*found, Trait("algorithm", spelled, named, of_algorithm=True)]


def _level(name: str, levels: dict[str, float]) -> Trait:
    """Return an ordinal trait of settings; a value names the level and its settings."""
    values: dict[str, str] = {}
    colours: dict[str, str] = {}
    for level in sorted(set(levels.values()), reverse=True):
        members = [setting for setting, own in levels.items() if own == level]
        text = f"{level:g} ({' '.join(members)})"
        values |= dict.fromkeys(members, text)
        colours[text] = style.level_colour(name, level)
    return Trait(name, values, colours, ordinal=True)
