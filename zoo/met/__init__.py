"""Whom a robot met in training: as the registry has it, and as others claim."""
