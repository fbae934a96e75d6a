"""Submitted robots: their admission and their cost."""
