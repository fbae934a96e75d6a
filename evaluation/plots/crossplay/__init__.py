"""The clustered cross-play matrix: its order, layout, strips and legend."""
