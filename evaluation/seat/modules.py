"""Modules of tasks in WebAssembly, with their manifest; made by `python -m tools.seat build`.

A module is checked against the manifest whenever it is read.
"""

import json
from importlib import resources
from typing import Any

from assistax_base.digest import sha256

MANIFEST = "manifest.json"
PARTS = ("wasm", "layout", "starts")  # of a module; the manifest has the hash of each
_ENDS = {"wasm": "wasm", "layout": "json", "starts": "starts"}


def playable() -> tuple[str, ...]:
    """Return the tasks that have a module."""
    return tuple(read_manifest()["tasks"])


def read_manifest() -> dict[str, Any]:
    """Return the manifest: "ziglang", its version, and "tasks", with version and hashes of each."""
    return json.loads(_file(MANIFEST))


def read_module(task: str) -> dict[str, bytes]:
    """Return the parts of a task's module by name.

    Raises:
        ValueError: The task has no module, or a part is not what the manifest says.
    """
    tasks = read_manifest()["tasks"]
    if task not in tasks:
        raise ValueError(f"{task} cannot be played in a page; allowed are {', '.join(tasks)}")
    parts = {part: _file(file_name(task, part)) for part in PARTS}
    for part, content in parts.items():
        if (found := sha256(content)) != tasks[task][part]:
            raise ValueError(
                f"{file_name(task, part)} has the sha256 {found}, and the manifest says "
                f"{tasks[task][part]}; install assistax-zoo again"
            )
    return parts


def file_name(task: str, part: str) -> str:
    """Return the name of a part's file."""
    return f"{task}.{_ENDS[part]}"


def _file(name: str) -> bytes:
    return (resources.files("evaluation.seat") / "modules" / name).read_bytes()
