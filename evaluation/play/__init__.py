"""Simulation of a study: the job, its tiles, the rollout, the runner."""
