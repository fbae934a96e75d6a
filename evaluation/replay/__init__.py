"""Replay of a saved result, and recomputation of its figures."""
