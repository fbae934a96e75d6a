"""Folder of the fused engine's machine code, and its safety check. Imports nothing heavy."""

import os
from pathlib import Path

VARIABLE = "XDG_CACHE_HOME"


def folder() -> Path:
    """Return this user's folder of compiled programs, which need not exist.

    Partners have another cache, which users may share: machine code that others can write is
    unsafe.
    """
    home = os.environ.get(VARIABLE) or os.path.expanduser("~/.cache")
    return Path(home, "assistax-zoo", "fused")


def refused(path: Path) -> str | None:
    """Return the reason not to run code of an existing folder; None if it is this user's alone."""
    status = path.stat()
    if status.st_uid == os.getuid() and not status.st_mode & 0o022:
        return None
    return (
        f"{path} belongs to another user or may be written by others, and machine code is run "
        f"from there; remove it, or set {VARIABLE} to a folder of your own"
    )
