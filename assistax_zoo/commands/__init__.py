"""One module for each family of commands; each command parses, calls one function, and prints."""
