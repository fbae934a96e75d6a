"""What every package uses: files, validation, errors, statistics. It imports none of them."""
