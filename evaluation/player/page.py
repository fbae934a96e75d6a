"""The page that plays an episode, and the data that players on other pages load."""

import base64
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evaluation.record import tables
from evaluation.report.page import templates


def pack(content: Mapping[str, Any]) -> bytes:
    """Return the content of `episode_content` as compressed JSON, which players load."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return zlib.compress(text.encode(), 9)


def write_episode(content: Mapping[str, Any], path: Path) -> None:
    """Write a page that plays an episode, atomically."""
    title, data = f"An episode of {content['task']}", base64.b64encode(pack(content)).decode()
    text = templates().get_template("watch.html").render(title=title, data=data)
    tables.write_bytes(text.encode(), path)
