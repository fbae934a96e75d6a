"""Tasks: pure JAX on sensor values, one file each."""

from assistax_envs.tasks.arm_assist import ArmAssist
from assistax_envs.tasks.base import Measures, Readings, Sensors, Task
from assistax_envs.tasks.bed_bath import BedBath
from assistax_envs.tasks.gentle_bath import GentleBath
from assistax_envs.tasks.gentle_lift import GentleLift
from assistax_envs.tasks.gentle_scratch import GentleScratch
from assistax_envs.tasks.scratch import Scratch

TASK_CLASSES: dict[str, type] = {
    task.name: task for task in (Scratch, BedBath, ArmAssist, GentleScratch, GentleBath, GentleLift)
}

__all__ = ["TASK_CLASSES", "Measures", "Readings", "Sensors", "Task"]
