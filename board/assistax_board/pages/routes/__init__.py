"""Addresses of the board's pages."""
