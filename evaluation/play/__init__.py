"""Playing: the job, its tiles, the rollout, the runner."""
