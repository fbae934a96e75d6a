"""The one rollout: robots play humans, for an evaluation and for training's final figures."""
