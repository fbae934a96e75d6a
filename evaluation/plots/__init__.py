"""Figures of saved tables; they compute only their layout."""
