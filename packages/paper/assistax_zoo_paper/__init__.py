"""Shards of the paper track, each under its sha256; `zoo.locations` finds them."""
