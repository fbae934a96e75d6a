"""Which devices play: all GPUs of this process, or as many CPU devices as there are cores.

On a CPU one program leaves cores idle, since XLA computes small matrix products on one of them. So
JAX is given several CPU devices before it starts, and each plays tiles of its own.
"""

import contextlib
import os

import jax

from population.devices import own_devices

MOST = 8  # each has a tile of up to 32,768 simulations in memory
# With fewer, compiling the programs once more takes longer than it saves.
SIMULATIONS_OF_A_CORE = 8192


def share_cores() -> None:
    """Give JAX a CPU device for each core, unless it has started or was told how many."""
    if "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    if jax.config.values["jax_num_cpu_devices"] < 0:
        with contextlib.suppress(RuntimeError):  # it has started
            jax.config.update("jax_num_cpu_devices", min(os.cpu_count() or 1, MOST))


def devices_for(simulations: int) -> tuple[jax.Device, ...]:
    """Return the devices that play so many simulations."""
    return own_devices(simulations // SIMULATIONS_OF_A_CORE)
