"""Publication of trained runs in a release."""
