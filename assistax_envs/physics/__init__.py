"""Physics backends behind one protocol."""

import jax
import mujoco

from assistax_envs.own_settings import check_platforms
from assistax_envs.physics.base import SUBSTEPS, Physics, PhysicsState, diverged

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
