"""Makes a generated program run: compilers, a cache of what they made, and calls from XLA."""
