"""Progress of a run, counted over all devices."""

import dataclasses
import threading
from collections.abc import Callable

import jax


@dataclasses.dataclass(frozen=True)
class Progress:
    """Progress of a run, in environment steps of this process."""

    done: int
    total: int
    seconds: float  # spent in the environment and the networks, without compilation
    what: str = "robots with humans"  # name of the policies that play, for messages
    stage: int = 1  # of a work of several runs, which run this is
    stages: int = 1


OnProgress = Callable[[Progress], None] | None  # called with the progress of a run


def staged(on_progress: OnProgress, stage: int, stages: int, what: str) -> OnProgress:
    """Return a function that reports a run as one stage of a work; None if there is no listener."""
    if on_progress is None:
        return None
    named = {"what": what, "stage": stage, "stages": stages}
    return lambda state: on_progress(dataclasses.replace(state, **named))


class Meter:
    """Counter of the steps of all devices that reports progress to the caller."""

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
        """Call `on_progress` with the current progress, if there is such a function."""
        if self._on_progress is not None:
            self._on_progress(Progress(self._done, self._total, self._longest()))

    def add(self, device: jax.Device, steps: int, seconds: float) -> None:
        """Count steps of a device and their seconds; raise if the run was stopped."""
        with self._lock:
            if self._stopped:
                raise _StoppedError
            self._done += steps
            self._seconds[device] = self._seconds.get(device, 0.0) + seconds
            self.report()

    def stop(self) -> None:
        """Make every device stop at its next call of `add`."""
        self._stopped = True

    def _longest(self) -> float:
        return max(self._seconds.values(), default=0.0)


class _StoppedError(Exception):
    """Another device failed, or the run was interrupted."""
