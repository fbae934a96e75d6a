"""The compilers that come with Warp: C++ to code for this CPU, CUDA to code for a GPU.

Warp brings clang (LLVM, with a linker in memory) and NVRTC in its two shared libraries, so users
need no compiler. The libraries are called directly, as Warp's own Python does in
`warp/_src/build.py`, and Warp itself is never imported. The public way, a `wp.kernel` around a
`wp.func_native` snippet, would cost a second of import at every start, print lines, forbid macros,
and leave Python between XLA and the machine code; here a compiled XLA call is loaded unchanged. The
price is that these C functions may change with any release of Warp: `mujoco-mjx` pins the release,
and any other one is refused by name.
"""

import ctypes
import functools
import importlib.metadata
import importlib.util
import platform
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

WARP = "1.18.0"  # the release whose C functions are declared below
NVRTC_OPTIMIZATION = 3
_NAMES = {"linux": ("warp.so", "warp-clang.so"), "darwin": ("libwarp.dylib", "libwarp-clang.dylib")}
_LOADING = threading.Lock()


def unavailable() -> str | None:
    """Return the reason why Warp's compilers cannot be used here, or None if they can."""
    if sys.platform not in _NAMES:
        return f"the fused engine has not been made to run on {sys.platform}"
    if platform.machine() not in ("x86_64", "aarch64", "arm64"):
        return f"Warp has no compiler for {platform.machine()} processors"
    try:
        found = importlib.metadata.version("warp-lang")
    except importlib.metadata.PackageNotFoundError:
        return f"the package warp-lang is not installed; pip install warp-lang=={WARP}"
    if found != WARP:
        return f"warp-lang {found} is installed; pip install warp-lang=={WARP}"
    missing = [name for name in _NAMES[sys.platform] if not (_home() / "bin" / name).exists()]
    return f"this build of warp-lang lacks {missing[0]}" if missing else None


def host_cpu() -> str:
    """Return this processor's name and features, for which machine code is made."""
    clang = _clang()
    return f"{clang.wp_get_host_cpu_name().decode()} {clang.wp_get_host_cpu_features().decode()}"


def compile_cpp(text: str, output: Path, flags: Sequence[str]) -> None:
    """Compile C++ to an object file; clang's front end takes `flags`, and -march=native."""
    given = (ctypes.c_char_p * (len(flags) + 1))(*(flag.encode() for flag in flags), None)
    debug = verify = tiles = verbose = headers = False
    # The name appears in messages only; there is no such file.
    failed = _clang().wp_compile_cpp(
        text.encode(), b"fused.cpp", _include(), str(output).encode(),
        debug, verify, False, tiles, given, 3, verbose, headers, None, 256,
    )  # fmt: skip
    if failed:
        raise RuntimeError("Warp's clang refused the fused engine's text; its reasons stand above")


def compile_cuda(text: str, output: Path, architecture: int) -> None:
    """Compile CUDA C++ to a cubin for one architecture (90 is Hopper); needs no GPU."""
    debug = verbose = verify = fast = fuse = lines = trace = headers = False
    failed = _core().wp_cuda_compile_program(
        text.encode(), b"fused.cu", architecture, b"", _include(), 0, None,
        debug, NVRTC_OPTIMIZATION, verbose, verify, fast, fuse, lines, trace, headers,
        str(output).encode(), None, 0, None, None, None,
    )  # fmt: skip
    if failed:
        raise RuntimeError("Warp's NVRTC refused the fused engine's text; its reasons stand above")


def load(path: Path, name: str, symbols: Sequence[str]) -> list[int]:
    """Link an object file into this process permanently; return the addresses of `symbols`."""
    clang = _clang()
    with _LOADING:
        # The linker needs functions for Warp's own kernels; we bind those that Warp binds.
        if not clang.wp_llvm_set_cpu_block_runtime(_core().wp_cpu_block_runtime_get_api()):
            raise RuntimeError("Warp's two libraries do not fit each other; install it again")
        if clang.wp_load_obj(str(path).encode(), name.encode(), False):
            raise RuntimeError(f"Warp's linker refused {path}; its reasons stand above")
        addresses = [clang.wp_lookup(name.encode(), symbol.encode()) for symbol in symbols]
    if not all(addresses):
        raise RuntimeError(f"{path} lacks one of {', '.join(symbols)}")
    return addresses


def _home() -> Path:
    """Return Warp's folder, without importing Warp."""
    spec = importlib.util.find_spec("warp")
    if spec is None or not spec.submodule_search_locations:
        raise ValueError(f"warp-lang is not installed; pip install warp-lang=={WARP}")
    return Path(spec.submodule_search_locations[0])


def _include() -> bytes:
    return str(_home() / "native").encode()


@functools.cache
def _clang() -> ctypes.CDLL:
    library = ctypes.CDLL(str(_home() / "bin" / _NAMES[sys.platform][1]))
    flag, text, texts = ctypes.c_bool, ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p)
    library.wp_get_host_cpu_name.restype = library.wp_get_host_cpu_features.restype = text
    library.wp_compile_cpp.argtypes = [
        *[text] * 4, *[flag] * 4, texts, ctypes.c_int, flag, flag, text, ctypes.c_int
    ]  # fmt: skip
    library.wp_llvm_set_cpu_block_runtime.argtypes = [ctypes.c_void_p]
    library.wp_load_obj.argtypes = [text, text, flag]
    library.wp_lookup.argtypes = [text, text]
    library.wp_lookup.restype = ctypes.c_uint64
    return library


@functools.cache
def _core() -> ctypes.CDLL:
    library = ctypes.CDLL(str(_home() / "bin" / _NAMES[sys.platform][0]))
    flag, text, texts = ctypes.c_bool, ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p)
    library.wp_cpu_block_runtime_get_api.restype = ctypes.c_void_p
    library.wp_cuda_compile_program.argtypes = [
        text, text, ctypes.c_int, text, text, ctypes.c_int, texts,
        flag, ctypes.c_int, *[flag] * 7, text, text,
        ctypes.c_size_t, texts, ctypes.POINTER(ctypes.c_size_t), ctypes.POINTER(ctypes.c_int),
    ]  # fmt: skip
    library.wp_cuda_compile_program.restype = ctypes.c_size_t
    return library
