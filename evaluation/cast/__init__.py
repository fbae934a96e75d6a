"""Robots and partners of a study: names, stacks, robots from outside, baseline policies."""
