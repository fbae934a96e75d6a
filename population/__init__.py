"""Policies and the trainers that make populations of them."""
