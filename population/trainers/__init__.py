"""Trainers: PPO and SAC, their common parts, and training partners."""
