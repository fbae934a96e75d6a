"""JAX under this project's own settings, whatever the user's process has set.

A process may choose another generator, other types or other checks for its own programs. Ours run
with the values of `OURS`, so that every process gets the same episodes; afterwards the user's
settings are restored. JAX keeps settings for each thread, so each thread enters ours itself.
"""

import contextlib
import functools
import operator
import os
from collections.abc import Callable
from typing import Any, Literal, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Shaped

P = ParamSpec("P")
T = TypeVar("T")

GENERATOR = "threefry2x32"  # generator of all our keys
# Rows of a batch are filled up to a multiple of this. A CPU computes the rows that do not fill a
# vector one by one and rounds them otherwise, so that last bits would depend on the batch. A batch
# of another size is another program, and may still differ in the last bit.
LANES = 16
_UNGUARDED = ("allow", None, "log", "log_explicit")
# Refused because XLA's threads, which do not enter our settings, pass arrays to callbacks
# explicitly.
_TOO_STRICT = "disallow_explicit"
_IGNORED = ("ignore",)

# Allowed values of settings; ours comes first, and the others are harmless.
OURS: dict[str, tuple[Any, ...]] = {
    "jax_allow_f16_reductions": (True,),
    "jax_check_tracer_leaks": (False,),
    "jax_debug_infs": (False,),
    "jax_debug_key_reuse": (False,),
    "jax_debug_nans": (False,),
    "jax_default_matmul_precision": (None,),
    "jax_default_prng_impl": (GENERATOR,),
    "jax_disable_jit": (False,),
    "jax_enable_x64": (False,),
    "jax_no_execution": (False,),
    "jax_no_tracing": (False,),
    "jax_numpy_dtype_promotion": ("standard",),
    "jax_softmax_custom_jvp": (False,),
    "jax_threefry_partitionable": (True,),
    "jax_transfer_guard": _UNGUARDED,
    "jax_transfer_guard_device_to_device": _UNGUARDED,
    "jax_transfer_guard_device_to_host": _UNGUARDED,
    "jax_transfer_guard_host_to_device": _UNGUARDED,
    # JAX sets these for a whole process only, so the user must set them back.
    "jax_error_checking_behavior_divide": _IGNORED,
    "jax_error_checking_behavior_nan": _IGNORED,
    "jax_error_checking_behavior_oob": _IGNORED,
    "jax_high_dynamic_range_gumbel": (False,),
}
# Settings that keep the user's values. They may change the last bits, and manifests record them.
FREE: dict[str, Any] = {
    "eager_constant_folding": False,
    "jax_compiler_enable_remat_pass": True,
    "jax_default_device": None,
    "jax_disable_most_optimizations": False,
    "jax_exec_time_optimization_effort": 0.0,
    "jax_memory_fitting_effort": 0.0,
    "jax_memory_fitting_level": "O2",
    "jax_optimization_level": "UNKNOWN",
    "jax_use_direct_linearize": True,
}
# One comparison recognises a process with our settings. Another JAX may lack some of them.
_KNOWN = {name: ours for name, ours in OURS.items() if hasattr(jax.config, name)}
_READ = operator.attrgetter(*_KNOWN)
_USUAL = tuple(None if ours is _UNGUARDED else ours[0] for ours in _KNOWN.values())
VARIABLES = ("XLA_FLAGS", "NVIDIA_TF32_OVERRIDE")  # environment variables, free as well


class own_settings:
    """Context manager and decorator under which a block or a function has our settings.

    If the process has them already, nothing is entered, and nothing is compiled again.

    Raises:
        ValueError: The process has a setting under which our programs cannot run.
    """

    def __enter__(self) -> None:
        self._entered = None if _READ(jax.config) == _USUAL else _entered()

    def __exit__(self, *error: Any) -> None:
        if self._entered is not None:
            self._entered.__exit__(*error)

    def __call__(self, function: Callable[P, T]) -> Callable[P, T]:
        """Return the function under our settings, entered in each call and thread."""

        @functools.wraps(function)
        def inside(*args: P.args, **kwargs: P.kwargs) -> T:
            if _READ(jax.config) == _USUAL:  # fast path, taken in each step of an environment
                return function(*args, **kwargs)
            with _entered():
                return function(*args, **kwargs)

        return inside


def _entered() -> contextlib.ExitStack:
    """Return a context in which settings with other values have ours."""
    check_settings()
    with contextlib.ExitStack() as stack:
        for name in _changed(OURS):
            stack.enter_context(getattr(jax, _switch(name))(OURS[name][0]))
        return stack.pop_all()


def check_settings() -> None:
    """Refuse a setting that only the user can set back.

    Raises:
        ValueError: There is such a setting; the message names it.
    """
    for name, value in _changed(OURS).items():
        if fate(name, value) == "refused":
            raise ValueError(
                f"JAX's {name} is {value!r} in this process, and episodes need {OURS[name][0]!r}; "
                f"set it back with jax.config.update, or unset {name.upper()}"
            )


def _switch(name: str) -> str:
    """Return JAX's name of a setting's context manager; some settings have none."""
    return name.removeprefix("jax_")


def _changed(usual: dict[str, tuple[Any, ...]]) -> dict[str, Any]:
    """Return this thread's settings whose values are not among `usual`, by name."""
    values = jax.config.values
    return {
        name: values[name] for name in usual if name in values and values[name] not in usual[name]
    }


@own_settings()
def key_of(seed: int | Shaped[np.ndarray, "..."]) -> jax.Array:
    """Return the key of a seed, or of each seed of an array, of `GENERATOR` in every process.

    They equal the keys of `jax.random.key` in a process with JAX's default generator. Only the
    lower 32 bits of a seed count.
    """
    low = np.asarray(seed if isinstance(seed, np.ndarray) else seed % 2**32).astype(np.uint32)
    words = np.stack([np.zeros_like(low), low], axis=-1)
    return jax.random.wrap_key_data(jnp.asarray(words), impl=GENERATOR)


def check_generator(keys: jax.Array) -> None:
    """Refuse keys of another generator.

    Other generators draw other numbers for a key that stands in another batch.

    Raises:
        ValueError: The keys are of another generator.
    """
    if (found := str(jax.random.key_impl(keys))) != GENERATOR:
        raise ValueError(
            f"the keys are of the generator {found}, and episodes need {GENERATOR}; make them with "
            f"jax.random.key(seed, impl={GENERATOR!r})"
        )


def fate(name: str, value: Any) -> Literal["replaced", "refused", "kept"]:
    """Return the treatment of a setting's value while our programs run."""
    if name not in OURS:
        return "kept"
    return "replaced" if hasattr(jax, _switch(name)) and value != _TOO_STRICT else "refused"


def check_platforms() -> None:
    """Refuse devices that JAX was told to use and that this machine lacks.

    Raises:
        ValueError: JAX has no such device; the message names JAX_PLATFORMS and a remedy.
    """
    platforms = jax.config.values["jax_platforms"]
    if platforms in (None, "", "cpu"):
        return
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:  # without a GPU "cuda" fails an assertion
        reason = str(error).partition("\n")[0].partition(" (set JAX_PLATFORMS")[0]
        raise ValueError(
            f"JAX has no device of JAX_PLATFORMS={platforms}{f' ({reason})' if reason else ''}; "
            "unset JAX_PLATFORMS to use this machine's devices, or set it to cpu"
        ) from None


def found_settings() -> dict[str, Any]:
    """Return the settings of this process, by name, that differ from JAX's defaults.

    Our programs run without those of `OURS`. They matter to robots from outside, which act under
    the user's settings.
    """
    found = _changed(OURS | {name: (value,) for name, value in FREE.items()})
    found |= {name: os.environ[name] for name in VARIABLES if os.environ.get(name)}
    return {
        name: value if isinstance(value, bool | int | float) else str(value)
        for name, value in sorted(found.items())
    }
