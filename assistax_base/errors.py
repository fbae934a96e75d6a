"""Errors of the zoo. Each names the expected, the found, the effect and the next step."""

import difflib
import errno
import reprlib
from collections.abc import Iterable

_REPR = reprlib.Repr()  # containers: their first few items alone
_REPR.maxstring = _REPR.maxother = 200
_LONGEST = 120  # characters of a value in an error
_MEMORY = ("cannot allocate memory", "out of memory", "resource_exhausted", "bad_alloc")


class ZooError(Exception):
    """Base of the family; its message is one line, ready for a user."""

    done, next_step = "nothing was done", ""
    remedy = ""  # a key of what to do next, by which a shell names its own option for it

    def __init_subclass__(cls, done: str = "", next_step: str = "", remedy: str = "") -> None:
        """Set the default effect and next step of the errors of this class."""
        cls.done, cls.next_step = done or cls.done, next_step or cls.next_step
        cls.remedy = remedy  # of this class's own next step alone

    def __init__(
        self,
        problem: str,
        expected: str,
        found: str,
        next_step: str = "",
        done: str = "",
        *,
        remedy: str = "",
    ) -> None:
        """Build the line from its five parts. The class has defaults for the last two."""
        self.problem, self.expected, self.found = problem, expected, found
        self.remedy = remedy if next_step else self.remedy
        self.next_step, self.done = next_step or self.next_step, done or self.done
        text = f"expected {expected}, found {found}; {self.done}; next: {self.next_step}"
        super().__init__(printable(f"{problem}: {text}"))


class AdvisedError(ValueError):
    """A ValueError with a `remedy`, by which a shell names its own option for the advice."""

    def __init__(self, message: str, remedy: str) -> None:
        super().__init__(message)
        self.remedy = remedy


class IdError(
    ZooError,
    done="nothing was looked up",
    next_step="correct the id; `assistax-zoo list` prints the known ones",
):
    """An id that the grammar does not accept."""


class UnknownIdError(
    ZooError,
    done="nothing was selected",
    next_step="`assistax-zoo list` prints every policy",
):
    """A well-formed id, pattern or filter that matches nothing in the registry."""


class RegistryError(
    ZooError,
    done="nothing was loaded",
    next_step="restore the file, or upgrade assistax-zoo if a newer version wrote it",
):
    """A registry that is missing, unreadable, or not of the schema."""


class RegistryVersionError(
    RegistryError,
    next_step="upgrade with `pip install -U assistax-zoo`",
):
    """A registry written for a newer schema than this installation knows."""


class FormatError(
    ZooError,
    done="nothing was loaded or written",
    next_step="check the path, or export the policy again",
):
    """A file that is not a well-formed shard, policy file or run folder."""


class IntegrityError(
    ZooError,
    done="nothing was loaded",
    next_step="`assistax-zoo fetch` it, or `git checkout -- FILE` in a checkout, then verify",
):
    """Bytes that differ from what the registry records."""


class SplitError(
    ZooError,
    done="no split was made or loaded",
    next_step="`assistax-zoo split list` prints them, `assistax-zoo split create` makes one; "
    "restore a published one with its registry",
):
    """A split that cannot be made, found, or trusted."""


class LeakageError(
    SplitError,
    done="the split was refused",
    next_step="take one of each pair out, or make another with `assistax-zoo split create`",
):
    """A split with the same team or the same parameters on both sides."""


class PublishError(
    ZooError,
    done="nothing was published",
    next_step="correct the run folder, or leave the team out, and publish again",
):
    """A publication that was refused."""


class ExportError(
    ZooError,
    done="nothing was written",
    next_step="choose another file, or replace this one",
    remedy="replace the file",
):
    """A file that would be overwritten."""


class SignatureError(
    ZooError,
    done="nothing was signed or verified",
    next_step="make one with `openssl genpkey -algorithm ed25519 -out key.pem`",
):
    """A key that cannot sign or verify."""


class ImmutableError(
    PublishError,
    done="nothing was published: what is published never changes",
    next_step="publish under a new release",
    remedy="new release",
):
    """A publication that would change published bytes."""


class RemoteError(
    ZooError,
    done="nothing was fetched",
    next_step="correct the remote's name",
):
    """A remote that cannot be reached, or lacks the requested file."""


class MissingFileError(RemoteError):
    """A file that the remote does not hold."""


class MissingRepositoryError(
    RemoteError,
    next_step="check the name; a private repository needs `hf auth login`",
):
    """A hub's repository that does not exist, or that this user may not see."""


class OfflineError(
    RemoteError,
    next_step="unset HF_HUB_OFFLINE, or fetch once while online",
):
    """Something that only a remote has, asked for in offline mode."""


class UpdateError(
    ZooError,
    done="nothing was fetched; the registry of before is kept",
    next_step="if they are meant, accept them, in Python by open_zoo(..., accept_changes=True)",
    remedy="accept changes",
):
    """Another zoo that changed the defaults of its users."""


class CacheError(
    ZooError,
    done="nothing was added; complete files are untouched",
):
    """A cache that cannot be written."""


class LockError(ZooError):
    """A lock file that is malformed, or bytes that differ from the pinned ones."""


def nearest(name: str, known: Iterable[str]) -> list[str]:
    """Return up to three known names that look most like the wanted one, best first."""
    return difflib.get_close_matches(name, sorted(known), n=3, cutoff=0.5)


def listing(names: Iterable[str], limit: int = 6) -> str:
    """Return the first names joined by commas, and the count of the rest."""
    names = list(names)
    rest = f" and {len(names) - limit} more" if len(names) > limit else ""
    return (", ".join(names[:limit]) + rest) if names else "none"


def counted(count: int, what: str) -> str:
    """Return a number of things in words: "1 seed", "2 seeds", "2 policies"."""
    if count != 1:
        what = f"{what[:-1]}ies" if what.endswith("y") else f"{what}s"
    return f"{count} {what}"


def shorten(value: object) -> str:
    """Return the value's `repr`, cut to the length of an error line."""
    text = _REPR.repr(value)
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."


def lacks_memory(error: BaseException) -> bool:
    """Return whether an error says that memory is short, which is no fault of any file."""
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return True
    words = str(error).lower()  # of Rust's and C++'s libraries, which have no class for it
    return any(word in words for word in _MEMORY)


def printable(text: str) -> str:
    """Replace line breaks, control and escape characters, which may come from a hostile file."""
    return "".join(character if character.isprintable() else " " for character in text)
