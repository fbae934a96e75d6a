"""Command line of the zoo: parse, call one function, print."""
