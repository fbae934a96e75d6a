"""Commands that evaluate robots."""
