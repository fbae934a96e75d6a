"""Slow values, computed in the background while readers see the previous one."""

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
        self._slots: dict[str, _Slot[Value]] = {}

    def value(self, name: str, key: Hashable, make: Callable[[], Value]) -> Value | None:
        """Return the value of a name: of this key, else an older one, else None."""
        with self._lock:
            slot = self._slots.setdefault(name, _Slot())
            slot.newest_key = key
            if slot.key != key and (slot.thread is None or not slot.thread.is_alive()):
                slot.thread = threading.Thread(target=slot.renew, args=(key, make), daemon=True)
                slot.thread.start()
        if slot.key != key and slot.thread is not None:
            slot.thread.join(PATIENCE)
        return slot.value

    def is_behind(self, name: str) -> bool:
        """Return whether the value of a name is older than the last request for it."""
        slot = self._slots.get(name)
        return slot is not None and slot.newest_key != slot.key


@dataclasses.dataclass
class _Slot(Generic[Value]):
    key: Hashable = None
    newest_key: Hashable = None
    value: Value | None = None
    thread: threading.Thread | None = None

    def renew(self, key: Hashable, make: Callable[[], Value]) -> None:
        self.value = make()
        self.key = key
