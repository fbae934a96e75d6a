"""The seat: a page on which a visitor is the person, and the modules that it runs."""
