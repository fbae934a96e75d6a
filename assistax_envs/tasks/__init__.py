"""Tasks: pure JAX on sensor values, one file each."""

from assistax_envs.tasks.base import Measures, Readings, Sensors, Task
from assistax_envs.tasks.scratch import Scratch

TASK_CLASSES: dict[str, type] = {"scratch": Scratch}

__all__ = ["TASK_CLASSES", "Measures", "Readings", "Sensors", "Task"]
