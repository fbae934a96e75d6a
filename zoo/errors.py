"""Errors of the zoo: each says what was expected and found, what was done, what to do next."""

import difflib
import reprlib
from collections.abc import Iterable

_REPR = reprlib.Repr()  # containers: their first few items alone
_REPR.maxstring = _REPR.maxother = 200


class ZooError(Exception):
    """Base of the family; its message is one line, ready for a user."""

    def __init__(
        self, problem: str, *, expected: str, found: str, done: str, next_step: str
    ) -> None:
        """Build the line from its five parts; they stay readable as attributes."""
        self.problem, self.expected, self.found, self.done, self.next_step = (
            problem,
            expected,
            found,
            done,
            next_step,
        )
        super().__init__(
            printable(f"{problem}: expected {expected}, found {found}; {done}; next: {next_step}")
        )


class IdError(ZooError):
    """An id that the grammar does not accept."""


class UnknownIdError(ZooError):
    """A well-formed id, pattern or filter that matches nothing in the registry."""


class RegistryError(ZooError):
    """A registry that is missing, unreadable, or not of the schema."""


class RegistryVersionError(RegistryError):
    """A registry written for a newer schema than this installation knows."""


class FormatError(ZooError):
    """A file that is not a well-formed shard, policy file or run folder."""


class IntegrityError(ZooError):
    """Bytes that differ from what the registry records."""


class SplitError(ZooError):
    """A split that cannot be made, found, or trusted."""


class LeakageError(SplitError):
    """A split with the same team or the same parameters on both sides."""


class PublishError(ZooError):
    """A publication that was refused."""


class ExportError(ZooError):
    """A file that would be overwritten."""


class SignatureError(ZooError):
    """A key that cannot sign or verify."""


class ImmutableError(PublishError):
    """A publication that would change what is already published."""


class RemoteError(ZooError):
    """A remote that cannot be reached, or does not hold what was asked of it."""


class MissingFileError(RemoteError):
    """A file that the remote does not hold."""


class MissingRepositoryError(RemoteError):
    """A hub's repository that does not exist, or that this user may not see."""


class OfflineError(RemoteError):
    """Something that only a remote has, asked for in offline mode."""


class CacheError(ZooError):
    """A cache that cannot be written."""


class LockError(ZooError):
    """A lock file that is malformed, or something else than what it pins."""


def nearest(wanted: str, known: Iterable[str], count: int = 3) -> list[str]:
    """Return up to `count` known names that look most like the wanted one, best first."""
    return difflib.get_close_matches(wanted, sorted(known), n=count, cutoff=0.5)


def listing(names: Iterable[str], limit: int = 6) -> str:
    """Return the first names joined by commas, and how many more there are."""
    names = list(names)
    rest = f" and {len(names) - limit} more" if len(names) > limit else ""
    return (", ".join(names[:limit]) + rest) if names else "none"


def shorten(value: object, limit: int = 120) -> str:
    """Return the value's `repr`, cut where it is too long for an error line; never all of it."""
    text = _REPR.repr(value)
    return text if len(text) <= limit else text[:limit] + "..."


def printable(text: str) -> str:
    """Replace line breaks, control and escape characters, which may come from a hostile file."""
    return "".join(character if character.isprintable() else " " for character in text)
