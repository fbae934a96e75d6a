"""Places on a board, and the ladder of them."""
