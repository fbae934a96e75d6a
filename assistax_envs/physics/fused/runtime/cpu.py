"""The compiled step on CPUs: vectors of simulations, divided among the threads of XLA."""

from collections.abc import Callable
from pathlib import Path

from assistax_envs import compiled
from assistax_envs.physics.fused.runtime import toolchain
from assistax_envs.physics.fused.runtime.xla import HERE, declarations, register_call

LANES = 8  # simulations in a vector: with 16, or with AVX-512, it is no faster
# Flags of clang's front end, which assumes neither errno nor traps. No flag may allow another
# processor to round differently.
FLAGS = ("-w", "-ffp-contract=off")
NATIVE = ("-march=native", "-mprefer-vector-width=256")


def register(
    name: str,
    key: str,
    source: Callable[[], str],
    lanes: int = LANES,
    features: tuple[str, ...] = NATIVE,
) -> None:
    """Register a program, compiled now or before, as the custom call `name` on CPUs.

    Args:
        name: of the call.
        key: of what the program's text is made from.
        source: makes the text; called only if it must be compiled.
        lanes: simulations in a vector.
        features: clang's flags for a processor; of this one if not given.
    """
    before = f"#define W {lanes}\n" + declarations()
    after = "".join(
        (HERE / file).read_text() for file in ("arrays.h", "step.h", "xla.h", "cpu_handler.h")
    )
    flags = (*FLAGS, *features)
    parts = (key, before, after, *flags, toolchain.WARP, toolchain.host_cpu())

    def build(output: Path) -> None:
        toolchain.compile_cpp(before + source() + after, output, flags)

    path = compiled.cached(compiled.key(part.encode() for part in parts), ".o", build)
    (address,) = toolchain.load(path, name, ["fused_step"])
    register_call(name, address, "cpu")
