"""Shards of the care track, each under its sha256; `zoo.locations` finds them."""
