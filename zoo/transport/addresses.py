"""Addresses of remotes, as users write them."""

import re
from pathlib import Path

from zoo.transport.remotes import FileRemote, HttpRemote, Remote, bad_address

_HUB = re.compile(r"hf://(?P<repo>[\w.-]+/[\w.-]+)(?:@(?P<revision>[^@\s]+))?")


def open_remote(text: str | Path) -> Remote:
    """Return the remote that the text names; nothing is read yet.

    Args:
        text: A folder, `https://...`, `hf://org/name` or `hf://org/name@revision`, or an fsspec URL
            such as `s3://...`.

    Raises:
        RemoteError: The text names no remote.
    """
    text = str(text)
    if text.startswith("hf://"):
        match = _HUB.fullmatch(text)
        if match is None:
            raise bad_address(text, "hf://org/name or hf://org/name@revision")
        # The hub's client is slow to import.
        from zoo.transport.hub import HubRemote

        return HubRemote(text, match["repo"], match["revision"] or "main")
    if text.startswith(("https://", "http://")):
        return HttpRemote(text)
    return FileRemote(text if "://" in text else str(Path(text).resolve()))
