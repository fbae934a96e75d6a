"""Commands for who evaluates robots."""
