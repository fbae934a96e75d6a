"""Partners of robots in training: networks and persons, which stay as they are."""
