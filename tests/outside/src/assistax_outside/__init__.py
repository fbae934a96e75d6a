"""What a package outside assistax-zoo adds to it."""
