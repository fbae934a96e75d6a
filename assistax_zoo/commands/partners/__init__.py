"""Commands for who takes, shares and cites partners."""
