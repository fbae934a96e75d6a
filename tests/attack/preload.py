"""What the server that forks has imported: most of what commands need, none of which has run.

Not Polars, nor what imports it: it starts threads, which no fork survives.
"""

import importlib
import os
import sys

# Before JAX and NumPy are imported, which read them once.
os.environ |= {"JAX_PLATFORMS": "cpu", "OPENBLAS_NUM_THREADS": "1"}
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"  # a toy compiles in little
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", os.path.expanduser("~/.cache/assistax-zoo/xla-tests")
)
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

NAMES = "jax mujoco flax.linen optax scipy.stats scipy.signal matplotlib.pyplot orbax.checkpoint "
NAMES += "httpx huggingface_hub cryptography assistax_zoo.shell.main population.trainers.ppo "
NAMES += "zoo.transport.fetch"
for name in NAMES.split():
    importlib.import_module(name)
assert "polars" not in sys.modules and len(os.listdir("/proc/self/task")) == 1
