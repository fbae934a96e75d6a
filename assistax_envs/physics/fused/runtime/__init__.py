"""Runtime of a generated program: compilers, a cache of their output, and calls from XLA."""
