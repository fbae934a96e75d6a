"""Physics backends behind one protocol."""

import jax
import mujoco

from assistax_envs.own_settings import check_platforms
from assistax_envs.physics.base import SUBSTEPS, Physics, PhysicsState, diverged
from assistax_envs.registered import REGISTERED

BACKENDS: tuple[str, ...] = ("fused", "native", "mjx", "mjx-warp")
# Backends whose contact sensors give a contact's frame beside its force.
GIVES_CONTACT_FRAMES: tuple[str, ...] = ("fused", "native")
# JAX's platforms on which "auto" is "fused", as it was tested against the other backends there.
FUSED_FIRST = ("cpu", "gpu")

__all__ = [
    "BACKENDS",
    "GIVES_CONTACT_FRAMES",
    "SUBSTEPS",
    "Physics",
    "PhysicsState",
    "check_scene",
    "diverged",
    "make_physics",
    "resolve_backend",
]


def resolve_backend(backend: str) -> str:
    """Return the name of a backend; "auto" becomes the fastest one that runs here.

    Raises:
        ValueError: There is no such backend, or JAX was told to use devices that are not here.
    """
    check_platforms()
    if backend == "auto":
        return _fastest_backend()
    if backend not in BACKENDS:
        raise ValueError(f"backend is {backend!r}; allowed are auto, {', '.join(BACKENDS)}")
    return backend


def make_physics(model: mujoco.MjModel, backend: str) -> Physics:
    """Return the backend named `backend`, one of `BACKENDS`, for `model`."""
    if backend == "fused":
        from assistax_envs.physics.fused.runtime.backend import FusedPhysics

        return FusedPhysics(model)
    if backend == "native":
        from assistax_envs.physics.native import NativePhysics

        return NativePhysics(model)
    from assistax_envs.physics.mjx import MjxPhysics

    return MjxPhysics(model, "warp" if backend == "mjx-warp" else "jax")


def check_scene(task: str, backend: str) -> None:
    """Check that a backend can play a task's scene.

    Raises:
        ValueError: There is no such scene, or the backend does not say which way contacts push.
    """
    if task not in REGISTERED:
        raise ValueError(
            f"there is no scene {task!r}; set the class's `scene` to one of {', '.join(REGISTERED)}"
        )
    if REGISTERED[task].felt and backend not in GIVES_CONTACT_FRAMES:
        raise ValueError(
            f"{task} needs to know which way a contact pushes, and backend {backend!r} does not "
            f"say; use {' or '.join(GIVES_CONTACT_FRAMES)}"
        )


def _fastest_backend() -> str:
    """Return the name of the fastest backend that runs on this machine."""
    if jax.default_backend() in FUSED_FIRST:
        from assistax_envs.physics.fused.runtime import toolchain

        if toolchain.unavailable() is None:
            return "fused"
    if jax.default_backend() == "cpu":
        return "native"
    try:
        import warp  # noqa: F401
    except ImportError:
        return "mjx"
    return "mjx-warp" if jax.default_backend() == "gpu" else "mjx"
