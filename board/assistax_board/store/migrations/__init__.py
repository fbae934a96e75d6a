"""Changes of a board's database: steps of its schema, and its move to another database."""
