"""Who plays: names, stacks, robots from outside, baseline policies."""
