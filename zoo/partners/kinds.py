"""The kinds of partners: the two of this package, then those of installed packages.

A package names a kind by an entry point of the group `assistax_zoo.partners`, whose name is the
kind's word: `mirrors = "my_package.mirrors:Mirrors"`, a subclass of
`zoo.partners.source.PartnerSource`.
"""

import functools
from collections.abc import Sequence
from typing import Any, ClassVar, Never

from assistax_base.extensions import NAME, PARTNERS, Extension, ExtensionError, usable_extensions
from zoo.partners.persons import Persons
from zoo.partners.sides import SIDES
from zoo.partners.source import PartnerSource
from zoo.partners.teams import Teams
from zoo.schema import PolicyEntry, Split

OWN_KINDS: tuple[type[PartnerSource], ...] = (Teams, Persons)
_OWN_WORDS = tuple(kind.word for kind in OWN_KINDS)


class BrokenKind(PartnerSource):
    """Stand-in for a package's kind that cannot be used: a request for its partners raises."""

    error: ClassVar[ExtensionError]

    @classmethod
    def owns(cls, name: str) -> bool:
        """Return whether an id or a glob has the kind's word where other kinds have theirs."""
        return f"/{cls.word}-" in name

    @classmethod
    def names_split(cls, text: str) -> bool:
        """Return whether a split has the kind's word; sides of splits keep their meaning."""
        return cls.word not in SIDES and super().names_split(text)

    def select(self, patterns: Sequence[str]) -> list[PolicyEntry]:
        """Raise the error of the package."""
        self._refuse()

    def split(self, task: str, name: str | None, release: str | None = None) -> Split | None:
        """Return None for a name of other kinds; raise the error of the package for its own."""
        return self._refuse() if name and self.names_split(name) else None

    def stacks(self, entries: Sequence[PolicyEntry]) -> Never:
        """Raise the error of the package."""
        self._refuse()

    def choose(self, *args: Any, **options: Any) -> Never:
        """Raise the error of the package."""
        self._refuse()

    def _refuse(self) -> Never:
        raise self.error.with_traceback(None)


@functools.cache
def kinds() -> tuple[type[PartnerSource], ...]:
    """Return the classes of all kinds: teams, persons, then those of packages by their names.

    A `BrokenKind` stands for a package's kind that cannot be used, unless its word is malformed or
    that of a kind of this package.
    """
    added, errors = _kinds_of_packages()
    for name, error in errors.items():
        if NAME.fullmatch(name) and name not in _OWN_WORDS:
            added[name] = type("Broken", (BrokenKind,), {"word": name, "error": error})
    return (*OWN_KINDS, *(added[name] for name in sorted(added)))


def broken_kinds() -> list[ExtensionError]:
    """Return the errors of the packages' kinds that cannot be used."""
    return list(_kinds_of_packages()[1].values())


def kind_of(names: Sequence[str]) -> type[PartnerSource]:
    """Return the kind that all partners of some ids are of; teams if they are of several."""
    made = kinds()[1:]
    return next((kind for kind in made if names and all(map(kind.owns, names))), Teams)


def described_kind() -> type[PartnerSource]:
    """Return the kind of this package whose partners are described by numbers."""
    return next(kind for kind in OWN_KINDS if kind.has_numbers)


def _kinds_of_packages() -> tuple[dict[str, type[PartnerSource]], dict[str, ExtensionError]]:
    """Return the classes of the packages' kinds, and the errors of those unusable, by name."""
    found, errors = usable_extensions(PARTNERS, taken=_OWN_WORDS)
    loaded: dict[str, type[PartnerSource]] = {}
    for name, extension in found.items():
        try:
            loaded[name] = _loaded(extension)
        except ExtensionError as error:
            errors[name] = error
    return loaded, errors


def _loaded(extension: Extension) -> type[PartnerSource]:
    """Return the class that an entry point names.

    Raises:
        ExtensionError: It cannot be imported, is no kind of partner, has another word, or its word
            is a side of splits.
    """
    if extension.name in SIDES:
        expected = f"a word that is not a side of splits ({', '.join(SIDES)})"
        raise extension.error(expected, f"the word {extension.name!r}")
    kind = extension.load()
    if not (isinstance(kind, type) and issubclass(kind, PartnerSource)):
        raise extension.error("a subclass of PartnerSource", repr(kind))
    word = getattr(kind, "word", None)
    if word != extension.name:
        raise extension.error(f"a kind whose `word` is {extension.name!r}", f"the word {word!r}")
    return kind
