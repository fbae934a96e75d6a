"""Partners that a robot met in training, by the registry or by the claims of others."""
