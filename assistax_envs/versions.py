"""Versions of the environments and of the engines, readable without JAX or MuJoCo.

A version is an integer. It is raised when the same actions from the same key give other
observations, rewards or episode ends on the same MuJoCo version: a changed model, task, observation
or reward. It is not raised for speed, rendering or documentation. `tests/envs/test_golden.py`
guards it. Each task has its own in its `TaskKind`.
"""

from collections.abc import Mapping
from importlib.metadata import version

from assistax_envs.registered import OURS as OURS
from assistax_envs.registered import PAPER, REGISTERED, TRACKS, ByTask
from assistax_envs.registered import track_of as track_of

VERSIONS: Mapping[str, int] = ByTask(lambda kind: kind.version)
TASKS: tuple[str, ...] = tuple(REGISTERED)
PAPER_TASKS: tuple[str, ...] = TRACKS[PAPER]


def __getattr__(name: str) -> tuple[str, ...]:
    """Return a group of tasks: gentle ones at the arm or at the mouth.

    A group is made on demand, because it needs the kind of every task.
    """
    groups = {
        "GENTLE_TASKS": ByTask(
            lambda kind: kind.name, lambda kind: kind.felt and kind.seat == "arm"
        ),
        "CARE_TASKS": ByTask(lambda kind: kind.name, lambda kind: kind.seat == "mouth"),
    }
    if name not in groups:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return tuple(groups[name])


def playable_version(task: str, version: int | None = None) -> int:
    """Return the version of a task's environment, which `version` may name.

    Raises:
        ValueError: `version` is another one.
    """
    installed = VERSIONS[task]
    if version not in (None, installed):
        raise ValueError(
            f"version of {task} is {version}; this installation plays version {installed}: leave "
            "the version out, or install the assistax-zoo that came with the other version"
        )
    return installed


# Of the fused engine's generator: goes up whenever any number that a program computes changes.
FUSED_VERSION = 1


def engine(backend: str) -> dict[str, str]:
    """Return the "name" and "version" of what computes a backend's physics.

    Another version may give other numbers, in the last bits or more, for the same version of the
    environment.
    """
    if backend == "fused":
        return {"name": backend, "version": str(FUSED_VERSION)}
    packages = {"native": "mujoco", "mjx": "mujoco-mjx", "mjx-warp": "mujoco-mjx"}
    if backend not in packages:
        allowed = ", ".join(("fused", *packages))
        raise ValueError(f"backend is {backend!r}; allowed are {allowed}")
    return {"name": backend, "version": version(packages[backend])}
