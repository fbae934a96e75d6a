"""How a folder came about: the command, the machine and the versions, for whoever wants to repeat it."""

import datetime
import importlib.metadata
import platform
from pathlib import Path
from typing import Any

from evaluation import tables

PACKAGES = (
    "assistax-zoo",
    "jax",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "flax",
    "numpy",
    "polars",
    "scipy",
)


def write_run(folder: Path, command: str, summary: dict[str, Any]) -> None:
    """Write how the folder's episodes came about; where they were found finished, what is there is kept."""
    path = folder / tables.RUN_FILE
    if summary["env_steps_per_second"] is not None or not path.is_file():
        tables.write_json(describe_run(command), path)


def describe_run(command: str) -> dict[str, Any]:
    """Return the command, date, machine and versions of this process."""
    import jax

    return {
        "command": command,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "devices": [device.device_kind for device in jax.devices()],
        "versions": {name: found for name in PACKAGES if (found := _version(name))},
    }


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
