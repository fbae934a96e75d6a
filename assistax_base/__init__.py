"""What every package uses: files, validation, errors, bounded reading. It imports none of them."""
