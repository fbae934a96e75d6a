"""A release beside the paper: the page docs/results.md, and the small tables it is made from."""
