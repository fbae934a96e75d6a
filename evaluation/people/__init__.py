"""Episodes in which a visitor of the browser page was the person."""
