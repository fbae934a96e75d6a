"""Probe of JAX and the compilers on this machine, run in a process of its own.

A driver may hang, and XLA ends the whole process on a flag that it does not know: `doctor` runs
this module and reads one JSON object from its standard output.
"""

import ctypes
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from assistax_envs.drawing.gl import told_choice
from assistax_envs.stdout import stdout_is_data


def probe() -> dict[str, Any]:
    """Return the findings by name. The text of an error replaces the finding that it prevented."""
    return {name: _tried(work) for name, work in PARTS.items()}


def _jax() -> dict[str, Any]:
    import jax

    from assistax_envs.own_settings import check_platforms

    check_platforms()
    kinds = [device.device_kind for device in jax.devices()]
    return {"platform": jax.default_backend(), "devices": kinds}


def _settings() -> dict[str, list[Any]]:
    """Return the value and the fate of each setting that is not JAX's own."""
    from assistax_envs.own_settings import fate, found_settings

    return {name: [value, fate(name, value)] for name, value in found_settings().items()}


def _backend() -> str:
    from assistax_envs.physics import resolve_backend

    return resolve_backend("auto")


def _fused() -> str | None:
    from assistax_envs.physics.fused.runtime import toolchain

    return toolchain.unavailable()


def _clang() -> float:
    """Return the seconds in which a small program was compiled, linked and called."""
    from assistax_envs.physics.fused.runtime import cpu, toolchain

    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "trial.o")
        text = 'extern "C" int trial() { return 42; }'
        toolchain.compile_cpp(text, path, (*cpu.FLAGS, *cpu.NATIVE))
        [address] = toolchain.load(path, Path(folder).name, ["trial"])
    if ctypes.CFUNCTYPE(ctypes.c_int)(address)() != 42:
        raise RuntimeError("a compiled program gave another number than it should")
    return time.perf_counter() - began


def _nvrtc() -> float | None:
    """Return the seconds of a small program for this machine's GPU; None if JAX has no GPU."""
    import jax

    from assistax_envs.physics.fused.runtime import gpu, toolchain

    if jax.default_backend() != "gpu":
        return None
    began = time.perf_counter()
    gpu.check_driver()
    with tempfile.TemporaryDirectory() as folder:
        text = 'extern "C" __global__ void trial() {}'
        toolchain.compile_cuda(text, Path(folder, "trial.cubin"), gpu.architecture())
    return time.perf_counter() - began


PARTS: dict[str, Callable[[], Any]] = {
    "jax": _jax,
    "settings": _settings,
    "backend": _backend,
    "fused": _fused,
    "clang": _clang,
    "nvrtc": _nvrtc,
}


def _tried(work: Callable[[], Any]) -> dict[str, Any]:
    try:
        return {"found": work()}
    except Exception as error:
        [line, *_] = str(error).splitlines() or [""]
        told = told_choice(line)
        if isinstance(error, ValueError) or told != line:
            return {"error": told}
        return {"error": f"{type(error).__name__}: {line}"}


if __name__ == "__main__":
    with stdout_is_data():
        answer = probe()
    print(json.dumps(answer))
