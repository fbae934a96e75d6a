"""Workers: processes that play the board's jobs."""
