"""Populations by plan: what to train, how far it is, the next share."""
