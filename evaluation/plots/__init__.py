"""Figures: each draws a saved table and computes nothing but its layout."""
