"""How far a run is, counted over all devices."""

import dataclasses
import threading
from collections.abc import Callable

import jax


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is, in environment steps of this process."""

    done: int
    total: int
    seconds: float  # spent in the environment and the networks, compilation not counted
    what: str = "policies"  # whose episodes these are


OnProgress = Callable[[Progress], None] | None  # told how far a run is


class Meter:
    """Counts what all devices have done, and tells the caller."""

    def __init__(self, total: int, on_progress: OnProgress = None) -> None:
        self._total, self._on_progress = total, on_progress
        self._done, self._seconds = 0, {}
        self._lock = threading.Lock()
        self._stopped = False

    @property
    def speed(self) -> float | None:
        """Environment steps per second of all devices together; None before the first step."""
        return self._done / self._longest() if self._done else None

    def report(self) -> None:
        """Tell the caller how far the run is."""
        if self._on_progress is not None:
            self._on_progress(Progress(self._done, self._total, self._longest()))

    def add(self, device: jax.Device, steps: int, seconds: float) -> None:
        """Count steps that a device has just done."""
        with self._lock:
            if self._stopped:
                raise _StoppedError
            self._done += steps
            self._seconds[device] = self._seconds.get(device, 0.0) + seconds
            self.report()

    def stop(self) -> None:
        """Make every device stop when it next has something to count."""
        self._stopped = True

    def _longest(self) -> float:
        return max(self._seconds.values(), default=0.0)


class _StoppedError(Exception):
    """Another device failed, or the run was interrupted."""
