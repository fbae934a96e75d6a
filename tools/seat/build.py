"""Compiles a task's module: the fused engine's text and the traced functions, by Zig's clang."""

import importlib.util
import json
import subprocess
import sys
import tempfile
from importlib import resources
from pathlib import Path

import numpy as np

from assistax_base.digest import sha256
from assistax_envs.physics.fused.program import generate
from population.networks.spec import PolicySpec
from tools.seat.golden import begun, memory_of
from tools.seat.traces import TaskTraces

STARTS = 64
ZIG = "0.17.1"  # of the package ziglang
FLAGS = (
    *("cc", "-x", "c++", "-target", "wasm32-freestanding", "-nostdlib", "-std=c++20", "-w"),
    *("-ffp-contract=off", "-fno-sanitize=all", "-fno-exceptions", "-fno-rtti", "-g0"),
    *("-fno-strict-aliasing", "-ffreestanding", "-mbulk-memory"),
)
# The traced functions are long and run once a step: small code is better there.
ENGINE, FUNCTIONS = ("-O2",), ("-Os",)
LINK = ("-Wl,--no-entry", "-Wl,--strip-all", "-Wl,--gc-sections")
TYPES = "typedef __SIZE_TYPE__ size_t;\ntypedef __INT64_TYPE__ int64_t;\n"
# One simulation of the engine, in place of XLA's call.
ADVANCE = """
static int only[1];
extern "C" void advance(
    const float* q, const float* v, const float* w, const float* u, const float* range,
    float* q_after, float* v_after, float* w_after, float* sensors, int substeps) {
  Arrays a = {q, v, w, u, range, q_after, v_after, w_after, sensors, only, 1, substeps};
  simulate(a, 0);
}
"""


def build(task: str, spec: PolicySpec) -> tuple[dict[str, bytes], dict[str, int | str]]:
    """Return the parts of a task's module by name, and the manifest's entry.

    Raises:
        RuntimeError: Zig is missing or refuses the text.
    """
    traces = TaskTraces(task, spec)
    functions = traces.text()
    runtime = resources.files("tools.seat").joinpath("runtime.h").read_text()
    head = f"{TYPES}#define WORDS {traces.layout.words}\n{runtime}"
    engine = engine_text(traces)
    layout = {
        "task": task,
        "version": traces.env.version,
        "network": spec.digest,
        "terms": list(traces.env.term_names),
        "pointer": traces.visitor.pointer_size,
        "memory": traces.layout.content(),
    }
    parts = {
        "wasm": compiled({"engine": (engine, ENGINE), "functions": (head + functions, FUNCTIONS)}),
        "layout": (json.dumps(layout, separators=(",", ":")) + "\n").encode(),
        "starts": starts(traces),
    }
    hashes = {name: sha256(content) for name, content in parts.items()}
    text = {"version": traces.env.version, "engine": sha256(engine.encode())}
    return parts, text | hashes


def starts(traces: TaskTraces) -> bytes:
    """Return what seeds 0 to `STARTS` - 1 draw: rows of a state's words before its observations."""
    places = traces.layout.trees["state"][0]
    drawn = next(place.offset for place in places if place.name.startswith(".obs"))
    size = drawn - places[0].offset
    rows = [memory_of(begun(traces, seed)[0])[:size] for seed in range(STARTS)]
    return np.stack(rows).astype("<u4").tobytes()


def engine_text(traces: TaskTraces) -> str:
    """Return the engine's text of one simulation at a time."""
    runtime = resources.files("assistax_envs.physics.fused.runtime")
    after = "".join(runtime.joinpath(name).read_text() for name in ("arrays.h", "step.h"))
    return f"#define W 1\n{TYPES}{generate(traces.env.model).source}{after}{ADVANCE}"


def compiled(parts: dict[str, tuple[str, tuple[str, ...]]]) -> bytes:
    """Return the module of C++ texts with their flags."""
    if importlib.util.find_spec("ziglang") is None:
        raise RuntimeError(f"the package ziglang is missing; pip install ziglang=={ZIG}")
    with tempfile.TemporaryDirectory(prefix="seat-") as name:
        folder, objects = Path(name), []
        for part, (text, flags) in parts.items():
            source = folder / f"{part}.cpp"
            source.write_text(text)
            objects.append(str(folder / f"{part}.o"))
            _zig([*FLAGS, *flags, "-c", str(source), "-o", objects[-1]], folder)
        linked = [flag for flag in FLAGS if flag not in ("-x", "c++")]
        _zig([*linked, *LINK, *objects, "-o", str(folder / "module.wasm")], folder)
        return (folder / "module.wasm").read_bytes()


def _zig(arguments: list[str], folder: Path) -> None:
    command = [sys.executable, "-m", "ziglang", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    if done.returncode:
        raise RuntimeError(f"zig refused the module's text: {done.stderr[-2000:]}")
