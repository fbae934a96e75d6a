"""Which option of the command line does what an error advises; libraries name no options."""

# By the key that an error has as `remedy`, see `assistax_base.errors.ZooError`.
REMEDIES = {
    "accept changes": "--yes accepts them",
    "fetch before": "--fetch does so in the same command",
    "name a remote": "--from names one",
    "new release": "--release v1, for example",
    "replace the file": "--force replaces it, --out names another",
}


def in_options(error: Exception) -> str:
    """Return what a shell user adds to the command, in brackets; empty where no option helps."""
    option = REMEDIES.get(getattr(error, "remedy", ""))
    return f" ({option})" if option else ""
