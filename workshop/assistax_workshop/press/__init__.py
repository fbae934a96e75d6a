"""From trained runs to a release."""
