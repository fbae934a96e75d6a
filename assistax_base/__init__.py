"""Shared base of all packages: files, validation, errors, statistics. It imports no other."""
