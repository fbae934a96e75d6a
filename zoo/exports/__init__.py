"""Exports for readers outside the zoo: cards, and policies in other formats."""
