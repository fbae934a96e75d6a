"""What is published never changes: the tree of leaves, signatures, official and own splits."""
