"""What a robot's training with partners may add to PPO, a file for each method."""
