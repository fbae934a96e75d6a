"""Parameters of policies: shards on disk and tensors in them."""
