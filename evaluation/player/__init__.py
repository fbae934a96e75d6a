"""The player of episodes: one script for pages of `watch`, reports and boards."""
