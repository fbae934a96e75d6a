"""Tasks: pure JAX on sensor values, one file each."""

import importlib
from typing import Any

from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.base import Measures, Readings, Sensors, Task

__all__ = ["TASK_CLASSES", "Measures", "Readings", "Sensors", "Task"]


def _load(home: str) -> type:
    module, name = home.split(":")
    return getattr(importlib.import_module(f"{__name__}.{module}"), name)


TASK_CLASSES: dict[str, Any] = {name: _load(task.home) for name, task in REGISTERED.items()}
