"""Commands that take, share and cite partners."""
