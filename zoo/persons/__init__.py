"""Persons of a release: rows of a formula in a seat, their entries, and their splits."""
