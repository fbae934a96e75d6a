"""The compiled step on NVIDIA GPUs: a thread for each simulation, launched by a call of XLA."""

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

from assistax_envs import compiled
from assistax_envs.physics.fused.runtime import toolchain
from assistax_envs.physics.fused.runtime.xla import HERE, declarations, register_call

_PROCESSOR_COUNT = 16  # CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT


def register(name: str, key: str, source: Callable[[], str]) -> None:
    """Register a program, compiled now or before, as the custom call `name` on GPUs.

    Args:
        name: of the call.
        key: of what the program's text is made from.
        source: makes the text; called only if it must be compiled.
    """
    kernel = _load_kernel(build_cubin(key, source, architecture()))
    step, bind = toolchain.load(build_handler(), f"{name}_gpu", ["fused_step", "fused_bind"])
    functions = _driver().cuLaunchKernel, _driver().cuGetErrorName
    calls = [ctypes.cast(function, ctypes.c_void_p) for function in functions]
    types = *[ctypes.c_void_p] * 3, ctypes.c_int
    ctypes.CFUNCTYPE(None, *types)(bind)(*calls, kernel, _processors())
    register_call(name, step, "CUDA")


def hardest_first(effort: jax.Array) -> jax.Array:
    """Return the order [N] of simulations in warps, hardest first; CPUs sort in the call itself.

    The threads of a warp wait for the slowest, and so does the end of a launch. Simulations of
    similar effort therefore stand side by side (see `grid.h`).
    """
    return jnp.argsort(-effort).astype(jnp.int32)


def architecture() -> int:
    """Return the compute capability of the GPUs that JAX has, 90 for 9.0."""
    found = {device.compute_capability for device in jax.local_devices(backend="gpu")}
    if len(found) > 1:
        raise ValueError(
            f"backend 'fused' needs GPUs of one kind, and there are {', '.join(sorted(found))}; "
            "choose with CUDA_VISIBLE_DEVICES"
        )
    return int(found.pop().replace(".", ""))


def check_driver() -> None:
    """Refuse a machine without an NVIDIA driver that can load the kernel.

    Raises:
        ValueError: The driver is missing or too old.
    """
    _check(_driver().cuInit(0))


def build_cubin(key: str, source: Callable[[], str], architecture: int) -> Path:
    """Return the path of a program's machine code for an architecture; needs no GPU."""
    before = "#define W 1\n"
    files = "arrays.h", "step.h", "grid.h", "gpu_kernel.h"
    after = "".join((HERE / file).read_text() for file in files)
    parts = (key, before, after, toolchain.WARP, str(architecture))
    return compiled.cached(
        compiled.key(part.encode() for part in parts),
        ".cubin",
        lambda output: toolchain.compile_cuda(before + source() + after, output, architecture),
    )


def build_handler() -> Path:
    """Return the path of the CPU's machine code that launches a kernel; it is the same for all."""
    texts = [(HERE / file).read_text() for file in ("arrays.h", "xla.h", "grid.h", "gpu_handler.h")]
    text = declarations() + "".join(texts)
    return compiled.cached(
        compiled.key(part.encode() for part in (text, toolchain.WARP, toolchain.host_cpu())),
        ".o",
        lambda output: toolchain.compile_cpp(text, output, ["-w"]),
    )


def _load_kernel(path: Path) -> int:
    """Return a handle of the kernel for every GPU; the driver copies it there on first use."""
    library, kernel = ctypes.c_void_p(), ctypes.c_void_p()
    image = path.read_bytes()
    check_driver()
    driver = _driver()
    options = [None, None, 0, None, None, 0]
    _check(driver.cuLibraryLoadData(ctypes.byref(library), image, *options))
    _check(driver.cuLibraryGetKernel(ctypes.byref(kernel), library, b"fused_kernel"))
    assert kernel.value is not None
    return kernel.value


def _processors() -> int:
    """Return the number of streaming multiprocessors of the first GPU."""
    found = ctypes.c_int()
    _check(_driver().cuDeviceGetAttribute(ctypes.byref(found), _PROCESSOR_COUNT, 0))
    return found.value


@functools.cache
def _driver() -> ctypes.CDLL:
    """Return NVIDIA's driver library."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError as error:
        raise ValueError("backend 'fused' needs NVIDIA's driver for this GPU") from error
    if not hasattr(driver, "cuLibraryLoadData"):
        raise ValueError("backend 'fused' needs an NVIDIA driver for CUDA 12 or newer")
    return driver


def _check(status: int) -> None:
    """Raise RuntimeError with the driver's reason if `status` is not 0."""
    if status:
        text = ctypes.c_char_p()
        _driver().cuGetErrorString(status, ctypes.byref(text))
        reason = (text.value or b"unknown").decode()
        raise RuntimeError(f"NVIDIA's driver refused the fused engine: {reason} ({status})")
