"""A rehearsal: a whole tiny season on this machine, made with the real commands and server."""
