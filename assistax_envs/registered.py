"""Every task by name: the eight of this package, then those of installed packages.

Another package adds a task by an entry point of the group `assistax_zoo.tasks`, which names a
`assistax_envs.tasks.kind.TaskKind`. A task's modules are imported when the task is asked for.
Imports no JAX or MuJoCo.
"""

import functools
import importlib
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from assistax_envs.tasks.kind import TaskKind

T = TypeVar("T")

OURS = (
    *("scratch", "bed_bath", "arm_assist"),
    *("gentle_scratch", "gentle_bath", "gentle_lift", "gentle_feeding", "gentle_brushing"),
)
GROUP = "assistax_zoo.tasks"


def load(place: str) -> Any:
    """Return the object at "MODULE:ATTRIBUTE"."""
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


class Kinds(Mapping[str, "TaskKind"]):
    """The kind of each task by name, imported at the first lookup.

    Iterating gives the names alone: our own in a fixed order, then those of other packages in
    alphabetical order. A name that is taken twice, or an entry point that gives no kind of its
    name, raises a `ValueError` that names the package.
    """

    def __init__(self) -> None:
        self._kinds: dict[str, TaskKind] = {}

    def __getitem__(self, name: str) -> "TaskKind":
        if name not in self._kinds:
            if name in OURS:
                self._kinds[name] = load(f"assistax_envs.tasks.{name}:TASK")
            else:
                self._kinds[name] = _kind(self._entries[name])
        return self._kinds[name]

    def __contains__(self, name: object) -> bool:
        return name in OURS or name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter((*OURS, *self._entries))

    def __len__(self) -> int:
        return len(OURS) + len(self._entries)

    @functools.cached_property
    def _entries(self) -> dict[str, EntryPoint]:
        found: dict[str, EntryPoint] = {}
        for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
            if entry.name in OURS or entry.name in found:
                owner = "assistax-zoo" if entry.name in OURS else _package(found[entry.name])
                raise ValueError(
                    f"the package {_package(entry)} adds a task {entry.name!r}, which {owner} has "
                    f"too; rename the task's entry point in the group {GROUP}, or uninstall "
                    f"{_package(entry)}"
                )
            found[entry.name] = entry
        return found


REGISTERED = Kinds()


class ByTask(Mapping[str, T], Generic[T]):
    """A property of the tasks that have it, by task name, read from a task's kind on lookup."""

    def __init__(
        self,
        read: Callable[["TaskKind"], T],
        has: Callable[["TaskKind"], bool] = lambda kind: True,
    ) -> None:
        self._read, self._has = read, has

    def __getitem__(self, task: str) -> T:
        kind = REGISTERED[task]
        if not self._has(kind):
            raise KeyError(task)
        return self._read(kind)

    def __contains__(self, task: object) -> bool:
        return isinstance(task, str) and task in REGISTERED and self._has(REGISTERED[task])

    def __iter__(self) -> Iterator[str]:
        return (task for task in REGISTERED if self._has(REGISTERED[task]))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        return repr(dict(self))


TASK_CLASSES: Mapping[str, Any] = ByTask(lambda kind: load(kind.make))


def _kind(entry: EntryPoint) -> "TaskKind":
    """Return the kind that an entry point names."""
    task_kind = load("assistax_envs.tasks.kind:TaskKind")
    try:
        kind = entry.load()
    except Exception as error:
        raise ValueError(
            f"task {entry.name!r} of the package {_package(entry)} cannot be loaded "
            f"({type(error).__name__}: {error}); repair or uninstall {_package(entry)}"
        ) from error
    if not isinstance(kind, task_kind) or kind.name != entry.name:
        found = f"a task {kind.name!r}" if isinstance(kind, task_kind) else type(kind).__name__
        raise ValueError(
            f"the entry point {entry.name!r} of the package {_package(entry)} gives {found}; it "
            f"must give a TaskKind of that name: correct it, or uninstall {_package(entry)}"
        )
    return kind


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist else entry.value
