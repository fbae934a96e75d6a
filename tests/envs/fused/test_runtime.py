"""Compiling, caching and calling, with a program small enough to be checked by hand."""

import ctypes
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import compiled
from assistax_envs.physics.fused.runtime import cpu, gpu, toolchain

# A mass on a line, a motor on it and three sensors, the last of which no model could have: how hard
# the hardest of a vector is. Beyond its range it "cannot be solved"; its effort is where it is.
TOY = """
#if W == 1
typedef float real;
#else
typedef float real __attribute__((vector_size(4 * W)));
#endif
#ifdef __CUDACC__
#define FN static __device__ __forceinline__
#else
#define FN static inline
#endif
#define LANES(l) for (int l = 0; l < W; ++l)
FN float& lane(real& x, int l) { return ((float*)&x)[l]; }
FN float lane(const real& x, int l) { return ((const float*)&x)[l]; }
enum { NV = 1, NU = 1, NSENS = 3, NPEAK = 0, NWARM = 1 };
struct Report { int flags[W] = {}, effort[W] = {}; };
template <class Sensors>
FN void substep(real* q, real* qd, const real* u, const real* lo, const real* hi,
                Sensors& sensors, real* peaks, bool last, unsigned* warm, Report& report) {
  if (last) {
    sensors[0] = q[0];
    sensors[1] = qd[0] * 1e-30f;
    float hardest = 0.0f;
    LANES(l) hardest = hardest < lane(q[0], l) ? lane(q[0], l) : hardest;
    LANES(l) lane(sensors[2], l) = hardest;
  }
  LANES(l) report.effort[l] += (int)lane(q[0], l);
  LANES(l) report.flags[l] |= lane(q[0], l) < lane(lo[0], l) || lane(q[0], l) > lane(hi[0], l);
  qd[0] = qd[0] + 0.5f * u[0];
  q[0] = q[0] + 0.25f * qd[0];
}
"""
WIDTHS = 1, 1, 1, 3  # of what a call returns


@pytest.fixture(scope="module")
def call() -> str:
    cpu.register("toy_step", "toy", lambda: TOY)
    return "toy_step"


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "assistax-zoo" / "fused"


def run(call: str, q, qd, u, substeps: int = 4, effort=0.0):
    """Return positions, velocities and the first two sensors, then efforts and the third sensor."""
    n = q.shape[0]
    shapes = [jax.ShapeDtypeStruct((n, width), jnp.float32) for width in WIDTHS]
    bounds = jnp.tile(jnp.array([[[-100.0, 100.0]]]), (n, 1, 1))
    inputs = q, qd, jnp.broadcast_to(effort, (n, 1)).astype(jnp.float32), u, bounds
    q, qd, effort, sensors = jax.ffi.ffi_call(call, shapes)(*inputs, substeps=np.int32(substeps))
    return q, qd, sensors[:, :2], effort, sensors[:, 2:]


def by_hand(q: np.ndarray, qd: np.ndarray, u: np.ndarray, substeps: int = 4):
    for _ in range(substeps):
        before = q, qd * np.float32(1e-30)
        qd = qd + np.float32(0.5) * u
        q = q + np.float32(0.25) * qd
    return q, qd, np.concatenate(before, axis=1)


def states(n: int) -> list[jax.Array]:
    rng = np.random.default_rng(n)
    return [jnp.asarray(rng.normal(size=(n, 1)), jnp.float32) for _ in range(3)]


@pytest.mark.parametrize("n", [1, 7, 8, 9, 1000])
@pytest.mark.parametrize("substeps", [1, 4])
def test_a_batch_of_any_size(call: str, n: int, substeps: int) -> None:
    inputs = states(n)
    results = run(call, *inputs, substeps=substeps)
    for a, b in zip(results[:3], by_hand(*map(np.asarray, inputs), substeps), strict=True):
        np.testing.assert_array_equal(a, b)


def test_inside_jit_and_scan(call: str) -> None:
    q, qd, u = states(300)

    @jax.jit
    def play(q, qd):
        return jax.lax.scan(lambda s, _: (tuple(run(call, *s, u)[:2]), None), (q, qd), length=5)[0]

    expected = np.asarray(q), np.asarray(qd)
    for _ in range(5):
        expected = by_hand(*expected, np.asarray(u))[:2]
    for a, b in zip(play(q, qd), expected, strict=True):
        np.testing.assert_array_equal(a, b)


def test_calls_from_many_threads_end(call: str) -> None:
    inputs = states(5000)
    step = jax.jit(lambda *args: run(call, *args))
    expected = step(*inputs)
    wrong: list[int] = []

    def work(k: int) -> None:
        for _ in range(20):
            if not np.array_equal(step(*inputs)[0], expected[0]):
                wrong.append(k)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
        assert not thread.is_alive()
    assert not wrong


def test_unsolved_simulation_is_nan_without_its_neighbours(call: str) -> None:
    q, qd, u = states(16)
    results = run(call, q.at[5].set(200.0), qd, u)
    expected = run(call, q, qd, u)
    assert np.isnan(results[1][5]).all()
    for a, b in zip(results[:3], expected[:3], strict=True):
        np.testing.assert_array_equal(np.delete(a, 5, 0), np.delete(b, 5, 0))


def test_numbers_below_the_normal_ones_are_kept(call: str) -> None:
    q, qd, u = states(40)
    small = np.asarray(run(call, q, qd * 1e-10, u * 0)[2])[:, 1]
    np.testing.assert_array_equal(small, np.asarray(qd * 1e-10)[:, 0] * np.float32(1e-30))
    assert (np.abs(small) < 1e-38).all()
    assert (small != 0).all()


@pytest.mark.parametrize(("lanes", "features"), [(1, ()), (4, ()), (8, ()), (16, cpu.NATIVE)])
def test_every_width_and_processor_gives_the_same_bits(call: str, lanes: int, features) -> None:
    name = f"toy_step_{lanes}"
    cpu.register(name, "toy", lambda: TOY, lanes, features)
    inputs = states(37)
    for a, b in zip(run(name, *inputs)[:3], run(call, *inputs)[:3], strict=True):
        np.testing.assert_array_equal(a, b)


def test_simulations_of_equal_effort_share_vectors_exactly(
    call: str,
) -> None:
    n = 4 * cpu.LANES
    hard = jnp.arange(n)[:, None] % 2 == 0
    q, still = jnp.where(hard, 50.0, 1.0), jnp.zeros((n, 1))
    *numbers, effort, hardest = run(call, q, still, still)
    assert (hardest == 50.0).all()  # nothing is known before the first step
    np.testing.assert_array_equal(effort, 4 * q)
    *again, _, hardest = run(call, q, still, still, effort=effort)
    np.testing.assert_array_equal(hardest, q)
    for wrong in (jnp.nan, jnp.inf, -1.0, 1e30, jnp.where(hard, -jnp.inf, jnp.nan)):
        results = run(call, q, still, still, effort=wrong)[:3]
        for a, b, c in zip(results, numbers, again, strict=True):
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(b, c)


def test_no_text_has_assembly() -> None:
    """Warp's clang aborts the process on it where the processor is an ARM: see `tools/arm.sh`."""
    texts = {
        path.name: path.read_text()
        for home in (cpu.HERE, cpu.HERE.parent)
        for path in home.glob("*.h")
    }
    assert {"cpu_handler.h", "newton.h"} <= set(texts)
    assert [name for name, text in texts.items() if re.search(r"\basm( volatile)?\(", text)] == []


def test_kernel_compiles_for_an_absent_gpu(own_cache: Path) -> None:
    path = gpu.build_cubin("toy", lambda: TOY, 90)
    assert path.read_bytes()[:4] == b"\x7fELF"


def test_the_handler_of_gpus_takes_the_drivers_functions() -> None:
    step, bind = toolchain.load(gpu.build_handler(), "toy_gpu", ["fused_step", "fused_bind"])
    types = *[ctypes.c_void_p] * 3, ctypes.c_int
    ctypes.CFUNCTYPE(None, *types)(bind)(None, None, None, 132)
    assert step


@pytest.mark.parametrize(
    ("status", "name", "words"),
    [
        (2, b"CUDA_ERROR_OUT_OF_MEMORY", "CUDA_ERROR_OUT_OF_MEMORY (2); each launch needs memory"),
        (719, b"CUDA_ERROR_LAUNCH_FAILED", "CUDA_ERROR_LAUNCH_FAILED (719)"),
        (4711, None, "an unknown error (4711)"),
    ],
)
def test_a_refused_launch_has_cudas_name_and_code(status: int, name, words: str) -> None:
    handler = gpu.build_handler()
    _, bind, refusal = toolchain.load(
        handler, f"toy_gpu_{status}", ["fused_step", "fused_bind", "fused_refusal"]
    )
    named = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.POINTER(ctypes.c_char_p))

    @named
    def error_name(found: int, place) -> int:
        place[0] = name
        return int(name is None or found != status)

    types = ctypes.c_void_p, named, ctypes.c_void_p, ctypes.c_int
    ctypes.CFUNCTYPE(None, *types)(bind)(None, error_name, None, 132)
    text = ctypes.create_string_buffer(512)
    ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_char_p)(refusal)(status, text)
    told = text.value.decode()
    assert told.startswith(f"fused physics: the CUDA driver refused a launch: {words}")
    assert ("XLA_PYTHON_CLIENT_MEM_FRACTION" in told) == (status == 2) and len(told) < 480


# The kernel on a CPU, a thread after the other; it writes down which thread has which simulation.
THREADS_IN_TURN = """
#define FN static inline
#define __global__
#define __launch_bounds__(n)
struct Index { unsigned x; };
static Index gridDim, blockDim, blockIdx, threadIdx;
struct Arrays { long long n; };
static int *times, *block_of;
static void simulate(const Arrays&, long long place) {
  ++times[place];
  block_of[place] = (int)blockIdx.x;
}
"""
PLAY = """
extern "C" void play(long long n, int processors, int* grid, int* times_, int* block_of_) {
  Grid g = grid_of(n, processors);
  times = times_, block_of = block_of_;
  gridDim.x = grid[0] = (int)g.blocks, blockDim.x = grid[1] = (int)g.threads;
  for (blockIdx.x = 0; blockIdx.x < g.blocks; ++blockIdx.x)
    for (threadIdx.x = 0; threadIdx.x < g.threads; ++threadIdx.x)
      fused_kernel(Arrays{n}, processors);
}
"""


def played(play: int, n: int, processors: int) -> tuple[int, int, np.ndarray, np.ndarray]:
    """Return blocks, threads, and how often and in which block each simulation was played."""
    grid, times, block_of = (np.zeros(size, np.int32) for size in (2, n, n))
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (grid, times, block_of)]
    types = ctypes.c_longlong, ctypes.c_int, *[ctypes.c_void_p] * 3
    ctypes.CFUNCTYPE(None, *types)(play)(n, processors, *pointers)
    return int(grid[0]), int(grid[1]), times, block_of


def test_a_gpus_threads_share_out_the_simulations(tmp_path: Path) -> None:
    texts = [(gpu.HERE / file).read_text() for file in ("grid.h", "gpu_kernel.h")]
    text = "".join([THREADS_IN_TURN, *texts, PLAY])
    toolchain.compile_cpp(text, tmp_path / "play.o", ["-w"])
    (play,) = toolchain.load(tmp_path / "play.o", "toy_grid", ["play"])
    for n in (1, 31, 33, 792, 4224, 4225, 28512, 33792, 33793, 82944):
        blocks, threads, times, block_of = played(play, n, 132)
        assert (times[:-1] == 1).all(), n
        assert times[-1] == blocks * threads - n + 1  # those that are too many repeat the last
        assert blocks <= 132 * -(-n // (132 * 256))
        # few simulations lie on all processors, hard ones on as many as there are
        assert len(set(block_of[: 32 * 132])) == min(-(-n // 32), blocks, 132)
    assert (np.diff(block_of // 132) >= 0).all()  # of the largest: the hardest in the first wave


def test_gpu_order_is_hardest_first() -> None:
    effort = jnp.array([0.0, 5.0, jnp.nan, 2.0, 5.0, -jnp.inf])
    order = gpu.hardest_first(effort)
    assert order.dtype == jnp.int32
    assert order.tolist()[:4] == [1, 4, 3, 0]
    assert sorted(order.tolist()) == list(range(6))


def damaged(data: bytes) -> bytes:
    return data[:100] + bytes([data[100] ^ 1]) + data[101:]


@pytest.mark.parametrize("harm", [damaged, lambda data: data[:-1], lambda data: b""])
def test_a_harmed_file_is_built_anew(own_cache: Path, harm) -> None:
    whole = bytes(range(200))
    path = compiled.cached("key", ".o", lambda output: output.write_bytes(whole) and None)
    assert compiled.cached("key", ".o", lambda output: pytest.fail("built twice")) == path
    path.write_bytes(harm(whole))
    again = compiled.cached("key", ".o", lambda output: output.write_bytes(whole) and None)
    assert again.read_bytes() == whole
    assert list(own_cache.iterdir()) == [again]


def test_a_file_of_another_key_is_not_taken(own_cache: Path) -> None:
    path = compiled.cached("one", ".o", lambda output: output.write_bytes(b"one") and None)
    path.rename(path.with_name(path.name.replace("one-", "two-")))
    built = compiled.cached("two", ".o", lambda output: output.write_bytes(b"two") and None)
    assert built.read_bytes() == b"two"


def test_folder_writable_by_others_is_refused(own_cache: Path) -> None:
    own_cache.mkdir(parents=True)
    own_cache.chmod(0o777)
    with pytest.raises(ValueError, match="may be written by others"):
        compiled.cached("key", ".o", lambda output: pytest.fail("built"))


def test_parts_of_a_key_do_not_run_together() -> None:
    assert compiled.key([b"ab", b"c"]) != compiled.key([b"a", b"bc"])
    assert compiled.key([b"ab", b"c"]) == compiled.key([b"ab", b"c"])


def test_another_release_of_warp_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert toolchain.unavailable() is None
    monkeypatch.setattr(toolchain, "WARP", "1.17.0")
    assert "warp-lang 1.18.0 is installed; pip install warp-lang==1.17.0" in str(
        toolchain.unavailable()
    )


@pytest.mark.slow
def test_parallel_builds_are_quiet_without_warp(own_cache: Path) -> None:
    code = (
        "import sys; from tests.envs.fused.test_runtime import TOY, cpu;"
        "cpu.register('toy', 'toy', lambda: TOY); assert 'warp' not in sys.modules"
    )
    environ = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env=environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=Path(__file__).parents[3],
        )
        for _ in range(2)
    ]
    for process in processes:
        output, _ = process.communicate(timeout=120)
        assert (process.returncode, output) == (0, b"")
    assert len(list(own_cache.glob("*.o"))) in (1, 2)
