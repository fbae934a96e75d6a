"""Run the command line: `assistax-zoo`, or `python -m assistax_zoo`."""

import signal
import sys

from assistax_zoo.name_collisions import refuse_shadows
from assistax_zoo.shell.interrupts import end_now


def start() -> int:
    """Run the command line and return its exit code.

    Its modules take up to a second to import. Ctrl-C ends the process at once until they are there:
    nothing has begun that could be finished.
    """
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heard:  # not where it is ignored, as in the background
        signal.signal(signal.SIGINT, lambda number, frame: end_now())
    try:
        refuse_shadows()  # `-m` puts the working folder first on the module path
    except ImportError as error:
        sys.exit(f"error: {error}")
    from assistax_zoo.shell.caches import warn_once
    from assistax_zoo.shell.main import run

    warn_once()
    if heard:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return run()


if __name__ == "__main__":
    sys.exit(start())
