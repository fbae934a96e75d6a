"""JAX has a CPU device for each core if an evaluation starts it; large jobs use them."""

import os
import subprocess
import sys

import jax
import pytest

from evaluation.play.runner import SIMULATIONS_OF_A_CORE, devices_for

START = """
import os
os.cpu_count = lambda: 3
{before}
from evaluation.play.runner import share_cores
share_cores()
share_cores()
import jax
print(len(jax.local_devices()))
"""


@pytest.mark.slow_for("settings0", "settings1")
@pytest.mark.parametrize(
    ("settings", "before", "count"),
    [
        ({}, "", 3),
        ({"JAX_NUM_CPU_DEVICES": "2"}, "", 2),
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=4"}, "", 4),
        ({}, "import jax; jax.devices()", 1),
    ],
)
def test_jax_has_a_device_per_core(settings: dict[str, str], before: str, count: int) -> None:
    command = [sys.executable, "-c", START.format(before=before)]
    environment = {**os.environ, "XLA_FLAGS": "", **settings}
    printed = subprocess.check_output(command, env=environment, text=True, timeout=120)
    assert printed.split() == [str(count)]


def test_device_number_grows_with_job(monkeypatch: pytest.MonkeyPatch) -> None:
    three_times = jax.local_devices()[:1] * 3
    monkeypatch.setattr(jax, "local_devices", lambda: three_times)
    most = SIMULATIONS_OF_A_CORE
    counts = [len(devices_for(size)) for size in (1, 2 * most - 1, 2 * most, 100 * most)]
    assert counts == [1, 1, 2, 3]
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert len(devices_for(1)) == 3
