"""The time, handed in wherever it is needed, so that tests can let it jump."""

import time
from collections.abc import Callable

Clock = Callable[[], float]  # seconds since 1970

system_clock: Clock = time.time
