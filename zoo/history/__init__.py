"""History of publications: the tree of leaves, signatures, official and own splits."""
