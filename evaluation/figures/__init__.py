"""Figures from tables: estimates with intervals, metrics, summaries."""
