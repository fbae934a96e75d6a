"""Rollouts of stacked policies, statistics over episodes, and figures."""
