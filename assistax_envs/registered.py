"""Every task by name: the eight of this package, then those of installed packages.

Another package adds a task by an entry point of the group `assistax_zoo.tasks`, which names a
`assistax_envs.tasks.kind.TaskKind`. A task's modules are imported when the task is asked for.
Imports no JAX or MuJoCo.
"""

import importlib
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from assistax_base.extensions import TASKS, Extension, extensions

if TYPE_CHECKING:
    from assistax_envs.tasks.kind import TaskKind

T = TypeVar("T")

PAPER, CARE = "paper", "care"
# The tasks of each track: tasks, partners, splits and robots that belong together.
TRACKS: Mapping[str, tuple[str, ...]] = {
    PAPER: ("scratch", "bed_bath", "arm_assist"),
    CARE: ("gentle_scratch", "gentle_bath", "gentle_lift", "gentle_feeding", "gentle_brushing"),
}
OURS = (*TRACKS[PAPER], *TRACKS[CARE])


def track_of(task: str) -> str:
    """Return the track of a task; a task of another package is a track of its own."""
    return next((track for track, tasks in TRACKS.items() if task in tasks), task)


def load(place: str) -> Any:
    """Return the object at "MODULE:ATTRIBUTE"."""
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


class Kinds(Mapping[str, "TaskKind"]):
    """The kind of each task by name, imported at the first lookup.

    Iterating gives the names alone: our own in a fixed order, then those of other packages in
    alphabetical order. A name that is taken twice, or an entry point that gives no kind of its
    name, raises an `ExtensionError` that names the package.
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

    @property
    def _entries(self) -> Mapping[str, Extension]:
        return extensions(TASKS, OURS)


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


def _kind(extension: Extension) -> "TaskKind":
    """Return the kind that an entry point names."""
    task_kind, kind = load("assistax_envs.tasks.kind:TaskKind"), extension.load()
    if not isinstance(kind, task_kind) or kind.name != extension.name:
        found = f"a task {kind.name!r}" if isinstance(kind, task_kind) else type(kind).__name__
        raise extension.error(f"a TaskKind named {extension.name!r}", found)
    return kind
