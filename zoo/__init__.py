"""The published population: registry, shards, splits, remotes."""
