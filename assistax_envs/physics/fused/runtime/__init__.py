"""Makes a generated program run: compilers, a cache of what they made, and XLA calls on CPUs and GPUs."""
