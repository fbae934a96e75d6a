"""XLA's C interface for custom calls: its declarations, and the registration of a call."""

import ctypes
import functools
import re
from pathlib import Path

import jax

HERE = Path(__file__).parent


@functools.cache
def declarations() -> str:
    """Return the C declarations of the installed jaxlib, against which our code is compiled."""
    text = Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h").read_text()
    return (HERE / "freestanding.h").read_text() + re.sub(r"#include <.*>\n", "", text)


def register_call(name: str, address: int, platform: str) -> None:
    """Register the compiled function at `address` as XLA's custom call `name`."""
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype = ctypes.py_object
    capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    jax.ffi.register_ffi_target(name, capsule(address, None, None), platform=platform)
