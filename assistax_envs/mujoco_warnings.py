"""MuJoCo's warnings go to Python's log instead of a file in the user's folder.

By itself MuJoCo prints a warning, and appends it to MUJOCO_LOG.TXT wherever the process works.
"""

import contextlib
import logging
from collections.abc import Generator

import mujoco

LOG = logging.getLogger("mujoco")
UNSTABLE = "The simulation is unstable"  # every such simulation is flagged, counted and reported


@contextlib.contextmanager
def warnings_logged() -> Generator[None]:
    """Log MuJoCo's warnings of the block; a handler of the user's own hears them instead."""
    if mujoco.get_mju_user_warning() is not None:
        yield
        return
    mujoco.set_mju_user_warning(_log)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def _log(message: str) -> None:
    LOG.log(logging.DEBUG if UNSTABLE in message else logging.WARNING, message)
