"""Places on small drawings. Templates draw them as SVG, so no script and no picture is needed."""

import dataclasses
import math
from collections.abc import Iterable


@dataclasses.dataclass(frozen=True)
class Axis:
    """A line from `low` to `high`, `width` units long."""

    low: float
    high: float
    width: float = 200.0

    def at(self, value: float) -> float:
        """Return the position of a value, clipped to the line."""
        share = (value - self.low) / (self.high - self.low)
        return round(self.width * min(max(share, 0.0), 1.0), 1)

    def holds(self, value: float) -> bool:
        """Return whether a value is on the line."""
        return self.low <= value <= self.high


def axis_over(
    values: Iterable[float], *, around: float | None = None, width: float = 200.0
) -> Axis:
    """Return a line that holds all values with some room; `around` stands in its middle."""
    finite = [value for value in values if math.isfinite(value)] or [0.0]
    low, high = min(finite), max(finite)
    if around is not None:
        reach = max(abs(low - around), abs(high - around))
        low, high = around - reach, around + reach
    room = 0.05 * (high - low) or max(abs(high), 1.0) * 0.05
    return Axis(low - room, high + room, width)
