"""What an evaluation leaves: tables, the manifest, where everything came from."""
