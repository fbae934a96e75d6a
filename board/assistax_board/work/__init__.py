"""Workers: processes that play what the board asks."""
