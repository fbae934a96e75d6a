"""The rollout in which robots play humans, for evaluations and for training's final figures."""
