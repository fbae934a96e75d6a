"""Robots that are handed in: whether one is admitted, and what it may cost."""
