"""How zoos travel: remotes, downloads, zoos of others."""
