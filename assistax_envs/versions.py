"""Versions of the environments and of the engines, readable without JAX or MuJoCo.

A version is an integer. It is raised when the same actions from the same key give other
observations, rewards or episode ends on the same MuJoCo version: a changed model, task, observation
or reward. It is not raised for speed, rendering or documentation. `tests/envs/test_golden.py`
guards it. Each stands in its task's row of `assistax_envs.registered`.
"""

from importlib.metadata import version

from assistax_envs.registered import REGISTERED

VERSIONS: dict[str, int] = {name: task.version for name, task in REGISTERED.items()}

TASKS: tuple[str, ...] = tuple(REGISTERED)
PAPER_TASKS: tuple[str, ...] = tuple(name for name, task in REGISTERED.items() if task.paper)
GENTLE_TASKS: tuple[str, ...] = tuple(
    name for name, task in REGISTERED.items() if task.felt and task.seat == "arm"
)
# The gentle tasks at the mouth. Their published partners are persons; no team has learned them.
CARE_TASKS: tuple[str, ...] = tuple(
    name for name, task in REGISTERED.items() if task.seat == "mouth"
)


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
