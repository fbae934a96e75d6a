"""The league: making of its rows, and the tables and figures of its page."""
