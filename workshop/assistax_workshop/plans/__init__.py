"""Plans of populations: their runs, their status, and the next run to train."""
