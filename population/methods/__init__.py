"""Methods that a robot's training with partners may add to PPO, one file each."""
