"""Values that take long, computed behind their readers, who meanwhile see the one before."""

import dataclasses
import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")
PATIENCE = 2.0  # seconds that a reader waits for a value


class Behind(Generic[Value]):
    """Values by name; each is made anew when its key changes, by one thread at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[str, _Kept[Value]] = {}

    def value(self, name: str, key: Hashable, make: Callable[[], Value]) -> Value | None:
        """Return the value of a name: of this key, else an older one, else None."""
        with self._lock:
            kept = self._kept.setdefault(name, _Kept())
            kept.newest_key = key
            if kept.key != key and (kept.thread is None or not kept.thread.is_alive()):
                kept.thread = threading.Thread(target=kept.renew, args=(key, make), daemon=True)
                kept.thread.start()
        if kept.key != key and kept.thread is not None:
            kept.thread.join(PATIENCE)
        return kept.value

    def is_behind(self, name: str) -> bool:
        """Return whether the value of a name is older than what was asked for last."""
        kept = self._kept.get(name)
        return kept is not None and kept.newest_key != kept.key


@dataclasses.dataclass
class _Kept(Generic[Value]):
    key: Hashable = None
    newest_key: Hashable = None
    value: Value | None = None
    thread: threading.Thread | None = None

    def renew(self, key: Hashable, make: Callable[[], Value]) -> None:
        self.value = make()
        self.key = key
