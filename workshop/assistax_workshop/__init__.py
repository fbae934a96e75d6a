"""The makers' tools: plans of populations, releases, sweeps, gates of tasks."""
