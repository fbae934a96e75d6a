"""Commands for who trains."""
