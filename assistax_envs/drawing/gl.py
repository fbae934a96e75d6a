"""An OpenGL context without a display: EGL, or OSMesa where EGL does not run."""

import contextlib
import importlib
import os
import sys
from collections.abc import Generator
from typing import Any

PLATFORMS = ("egl", "osmesa")
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0 libosmesa6"
CHOICE = "MUJOCO_GL"
LIBRARY, VARIABLE = "OpenGL", "PYOPENGL_PLATFORM"  # PyOpenGL takes its platform on its first import


class RenderError(ValueError):
    """This machine cannot draw; the message names the packages to install."""


def open_context(width: int, height: int) -> tuple[str, Any]:
    """Return "egl" or "osmesa" and its context, for frames of up to `width` x `height` pixels.

    MUJOCO_GL=egl or MUJOCO_GL=osmesa leaves no choice.

    Raises:
        RenderError: neither platform works here.
    """
    wanted = os.environ.get(CHOICE, "").strip().lower()
    problems = []
    for platform in (wanted,) if wanted in PLATFORMS else PLATFORMS:
        free = VARIABLE not in os.environ and LIBRARY not in sys.modules
        try:
            return platform, importlib.import_module(f"mujoco.{platform}").GLContext(width, height)
        except Exception as error:  # whatever PyOpenGL makes of a library that is missing or broken
            problems.append(
                f"{platform}: {' '.join(str(error).split())[:100] or type(error).__name__}"
            )
            if free:
                _forget(platform)
    raise RenderError(
        f"this machine cannot draw without a display ({'; '.join(problems)}); EGL or OSMesa is "
        f"needed; on Debian or Ubuntu install them with: apt-get install {PACKAGES}"
    )


def told_choice(message: str) -> str:
    """Return MuJoCo's message about MUJOCO_GL with a remedy; other messages unchanged."""
    if CHOICE not in message:
        return message
    return (
        f"{CHOICE} is {os.environ.get(CHOICE)!r}, which MuJoCo does not know; set it to "
        f"{' or '.join(PLATFORMS)}, or unset it"
    )


@contextlib.contextmanager
def functions_from(platform: str) -> Generator[None]:
    """Let MuJoCo's C code load OpenGL's functions from the platform that the environment names."""
    before = os.environ.get(CHOICE)
    os.environ[CHOICE] = platform
    try:
        yield
    finally:
        if before is None:
            del os.environ[CHOICE]
        else:
            os.environ[CHOICE] = before


def _forget(platform: str) -> None:
    """Undo what the failed attempt imported, so that PyOpenGL can take another platform."""
    os.environ.pop(VARIABLE, None)
    for name in list(sys.modules):
        if name.startswith(
            (f"mujoco.{platform}", f"mujoco.rendering.classic.{platform}", f"{LIBRARY}.")
        ):
            del sys.modules[name]
    sys.modules.pop(LIBRARY, None)
