"""Runs: from a configuration to a folder of trained teams."""
