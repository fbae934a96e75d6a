"""Standard output that carries data stays clean, whatever libraries print."""

import ctypes
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager, redirect_stdout


@contextmanager
def stdout_is_data() -> Generator[None]:
    """Send the output of libraries, C code included, to standard error; results stand alone.

    Work inside the block, print the result after it:

        with stdout_is_data():
            result = work()
        print_json(result)
    """
    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        ctypes.CDLL(None).fflush(None)
        os.dup2(saved, 1)
        os.close(saved)
