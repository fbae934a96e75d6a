"""Methods: submissions that are seeds of one, with their returns, and copies of earlier robots."""

import contextlib
import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from assistax_base.digest import sha256
from assistax_base.errors import ZooError
from assistax_board.cards import LINK
from assistax_board.store.shown import Submission
from assistax_board.vocabulary import REFERENCE
from zoo.exports.policies import policy_file
from zoo.registry import Registry
from zoo.schema import PolicyEntry


@dataclasses.dataclass(frozen=True)
class Played:
    """Submissions of one method, which are its seeds, with their returns by partner."""

    submissions: tuple[Submission, ...]  # the oldest first
    returns: np.ndarray  # [S, P, K]
    copy_of: Submission | None = None  # an earlier robot that is the same as one of these

    @property
    def newest(self) -> Submission:
        """The submission that stands for the method in addresses."""
        return self.submissions[-1]

    @property
    def is_reference(self) -> bool:
        """Whether the row is there to be measured by."""
        return self.newest.submitter == REFERENCE

    @property
    def is_entry(self) -> bool:
        """Whether it is a lab's declared entry, and not a single robot or a reference."""
        return self.newest.entry is not None and not self.is_reference

    @property
    def is_published(self) -> bool:
        """Whether it is a declared entry of the zoo, which is there to be measured by."""
        return self.newest.entry is not None and self.newest.kind == "reference"

    @property
    def is_single(self) -> bool:
        """Whether no entry declared it, and it is no reference."""
        return not (self.is_entry or self.is_reference)

    @property
    def is_whole(self) -> bool:
        """Whether all seeds of a declared entry are scored."""
        return len(self.submissions) == self.newest.declared

    @property
    def competes(self) -> bool:
        """Whether it takes a place: a declared entry, whole, and no copy of an earlier robot."""
        return self.is_entry and self.is_whole and self.copy_of is None

    @property
    def links(self) -> dict[str, str]:
        """Return the addresses of paper and code that its lab gave, the newest ones, by name."""
        found = {}
        for seed in self.submissions:
            found |= {"paper": seed.link} if seed.link else {}
            code = (seed.card or {}).get("code", "")
            found |= {"code": code} if LINK.fullmatch(code) else {}
        return found

    @property
    def seeds_in_words(self) -> str:
        """Return its seeds in words, as "3 of 5 declared"."""
        count = len(self.submissions)
        if self.is_entry or self.is_published:
            return f"{count} of {self.newest.declared} declared"
        if self.is_reference:
            return ""
        return f"{count} single robots" if count > 1 else "single robot"


def group_methods(submissions: Iterable[Submission]) -> list[list[Submission]]:
    """Return the submissions of each method, the oldest first.

    A method is a declared entry, or all single robots of one lab and name.
    """
    groups: dict[tuple[str, str, str | None], list[Submission]] = {}
    for seed in sorted(submissions, key=lambda seed: (seed.created_at, seed.id)):
        groups.setdefault((seed.submitter, seed.method, seed.entry), []).append(seed)
    return list(groups.values())


def digest_of(returns: np.ndarray) -> str:
    """Return the sha256 of a robot's returns [P, K]: the same for the same robot."""
    return sha256(np.ascontiguousarray(returns).tobytes())


class ZooFiles:
    """The published egos of each task by the sha256 of their exported files.

    Claims inside a file are thus never asked. The result is kept: some egos met thousands.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._of: dict[str, dict[str, PolicyEntry]] = {}

    def of(self, task: str) -> Mapping[str, PolicyEntry]:
        """Return a task's egos by the sha256 of each file that `export` writes of a robot."""
        if task not in self._of:
            found = {}
            for ego in self._registry.policies:
                if ego.task == task and ego.trained_against:
                    with contextlib.suppress(ZooError):  # its parameters are not on this machine
                        for form in ("safetensors", "onnx"):
                            data = policy_file(ego.id, form, lambda: self._registry)
                            found[sha256(data)] = ego
            self._of[task] = found
        return self._of[task]

    def names(self, task: str) -> dict[str, str]:
        """Return the name of each ego within its task by the sha256 of its files."""
        return {digest: ego.team.partition("/")[2] for digest, ego in self.of(task).items()}


def find_copies(
    groups: Sequence[Sequence[Submission]],
    digests: Mapping[str, str],
    zoo_files: ZooFiles,
) -> dict[str, Submission]:
    """Return the methods that share a robot with an earlier one: the first one has the place.

    Robots are the same if their files are, or if they earned the same in every episode, as a file
    does whose bytes alone were changed. The zoo's robots are earlier than all: everybody has them.

    Args:
        groups: Submissions of each method.
        digests: Of the returns of each submission, see `digest_of`.
        zoo_files: Of the zoo's robots.

    Returns:
        The earlier robot, by the newest submission of the later method.
    """
    every = [seed for group in groups for seed in group]
    zoo = {seed.reference: seed for seed in every if seed.reference and seed.entry}
    first = {digests[seed.id]: seed for seed in zoo.values()}
    if zoo:
        named = zoo_files.names(every[0].task).items()
        first |= {digest: zoo[name] for digest, name in named if name in zoo}
    copies: dict[str, Submission] = {}
    for group in sorted(groups, key=lambda group: (group[0].created_at, group[0].id)):
        if group[0].submitter == REFERENCE:
            continue
        for seed in group:
            for name in (digests[seed.id], *([seed.artefact] if seed.artefact else ())):
                earlier = first.setdefault(name, seed)
                if all(earlier.id != own.id for own in group):
                    copies.setdefault(group[-1].id, earlier)
    return copies
