"""Making splits: by rule, by hand, and never with nearly the same human on both sides."""
