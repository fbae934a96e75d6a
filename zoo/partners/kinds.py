"""The kinds of partners: the two of this package, then those of installed packages.

A package names a kind in its entry points, group `assistax_zoo.partners`:
`mirrors = "my_package.mirrors:Mirrors"`, a subclass of `zoo.partners.source.PartnerSource`.
"""

import functools
from collections.abc import Sequence
from importlib import metadata

from zoo.partners.persons import Persons
from zoo.partners.source import PartnerSource
from zoo.partners.teams import Teams

GROUP = "assistax_zoo.partners"
OWN_KINDS: tuple[type[PartnerSource], ...] = (Teams, Persons)


@functools.cache
def kinds() -> tuple[type[PartnerSource], ...]:
    """Return the classes of all kinds: teams, persons, then those of packages by entry point.

    Raises:
        ValueError: A package's kind cannot be loaded, or has the word of another kind.
    """
    found, places = list(OWN_KINDS), {kind.word: "assistax-zoo" for kind in OWN_KINDS}
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: point.name):
        package = point.dist.name if point.dist else point.value
        kind = _loaded(point, package)
        if kind.word in places:
            raise ValueError(
                f"package {package} adds partners {kind.word!r}, which {places[kind.word]} has "
                "already; give them another word, or uninstall one of the two"
            )
        places[kind.word] = package
        found.append(kind)
    return tuple(found)


def kind_of(names: Sequence[str]) -> type[PartnerSource]:
    """Return the kind that all partners of some ids are of; teams if they are of several."""
    made = kinds()[1:]
    return next((kind for kind in made if names and all(map(kind.owns, names))), Teams)


def described_kind() -> type[PartnerSource]:
    """Return the kind of this package whose partners are described by numbers."""
    return next(kind for kind in OWN_KINDS if kind.has_numbers)


def _loaded(point: metadata.EntryPoint, package: str) -> type[PartnerSource]:
    """Return the class that an entry point names.

    Raises:
        ValueError: It cannot be imported, or is no kind of partner.
    """
    place = f"package {package} adds partners by {point.value!r}, which"
    try:
        kind = point.load()
    except Exception as error:  # whatever a stranger's module raises
        raise ValueError(
            f"{place} cannot be loaded ({type(error).__name__}: {error}); mend the package, or "
            "uninstall it"
        ) from error
    if not (isinstance(kind, type) and issubclass(kind, PartnerSource)):
        raise ValueError(f"{place} is no subclass of PartnerSource; mend the package")
    if not getattr(kind, "word", ""):
        raise ValueError(f"{place} has no word, by which its partners are chosen; set `word`")
    return kind
