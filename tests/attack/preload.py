"""What the server that forks has imported: all of the commands, none of which has run."""

import os

# Before JAX is imported, which reads them once.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", os.path.expanduser("~/.cache/assistax-zoo/xla-tests")
)
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"  # a toy compiles in little
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")
