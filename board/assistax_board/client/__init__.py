"""Who speaks to a board: a laboratory's client, and checks of what a board says."""
