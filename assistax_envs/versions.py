"""Versions of the environments and of the engines, readable without JAX or MuJoCo.

A version is an integer. It is raised when the same actions from the same key give other
observations, rewards or episode ends on the same MuJoCo version: a changed model, task, observation
or reward. It is not raised for speed, rendering or documentation. `tests/envs/test_golden.py`
guards it.
"""

from importlib.metadata import version

VERSIONS: dict[str, int] = {
    "scratch": 1,
    "bed_bath": 1,
    "arm_assist": 2,
    "gentle_scratch": 2,
    "gentle_bath": 2,
    "gentle_lift": 2,
}

TASKS: tuple[str, ...] = tuple(VERSIONS)
GENTLE_TASKS: tuple[str, ...] = ("gentle_scratch", "gentle_bath", "gentle_lift")
PAPER_TASKS: tuple[str, ...] = ("scratch", "bed_bath", "arm_assist")

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
        raise ValueError(
            f"backend is {backend!r}; allowed, where its version counts, are {allowed}"
        )
    return {"name": backend, "version": version(packages[backend])}
