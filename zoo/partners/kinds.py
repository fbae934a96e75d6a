"""The kinds of partners: the two of this package, then those of installed packages.

A package names a kind by an entry point of the group `assistax_zoo.partners`, whose name is the
kind's word: `mirrors = "my_package.mirrors:Mirrors"`, a subclass of
`zoo.partners.source.PartnerSource`.
"""

import functools
from collections.abc import Sequence

from assistax_base.extensions import PARTNERS, Extension, extensions
from zoo.partners.persons import Persons
from zoo.partners.source import PartnerSource
from zoo.partners.teams import Teams

OWN_KINDS: tuple[type[PartnerSource], ...] = (Teams, Persons)


@functools.cache
def kinds() -> tuple[type[PartnerSource], ...]:
    """Return the classes of all kinds: teams, persons, then those of packages by their names.

    Raises:
        ExtensionError: A package's kind cannot be loaded, or takes the word of another kind.
    """
    added = extensions(PARTNERS, taken=[kind.word for kind in OWN_KINDS])
    return (*OWN_KINDS, *map(_loaded, added.values()))


def kind_of(names: Sequence[str]) -> type[PartnerSource]:
    """Return the kind that all partners of some ids are of; teams if they are of several."""
    made = kinds()[1:]
    return next((kind for kind in made if names and all(map(kind.owns, names))), Teams)


def described_kind() -> type[PartnerSource]:
    """Return the kind of this package whose partners are described by numbers."""
    return next(kind for kind in OWN_KINDS if kind.has_numbers)


def _loaded(extension: Extension) -> type[PartnerSource]:
    """Return the class that an entry point names.

    Raises:
        ExtensionError: It cannot be imported, is no kind of partner, or has another word.
    """
    kind = extension.load()
    if not (isinstance(kind, type) and issubclass(kind, PartnerSource)):
        raise extension.error("a subclass of PartnerSource", repr(kind))
    word = getattr(kind, "word", None)
    if word != extension.name:
        raise extension.error(f"a kind whose `word` is {extension.name!r}", f"the word {word!r}")
    return kind
