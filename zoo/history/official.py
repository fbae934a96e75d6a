"""Official registries: releases of this project, which only those who make them may change.

A registry is official if one of its releases has the root of a release that came with this code,
whatever the file is called and wherever it lies. What others publish goes to a registry of theirs,
or to the user's own zoo (`zoo.locations.own_registry`).
"""

import os
from pathlib import Path
from typing import NoReturn

from assistax_base.bounded_reading import MAX_REGISTRY_BYTES, parse_json, read_text
from assistax_base.errors import PublishError, ZooError
from zoo.locations import registry_path, shipped_registry
from zoo.schema import RegistryFile

MAKER_VARIABLE = "ASSISTAX_ZOO_MAKER"  # set by those who make official releases


def is_official(data: RegistryFile) -> bool:
    """Return whether a registry holds a release that came with this code, by its root."""
    roots = {release.root for release in data.releases.values()}
    return not roots.isdisjoint(_recorded_roots(shipped_registry()))


def writable_registry(path: Path | str | None = None) -> Path | None:
    """Return the registry that a publication goes to; None where it goes to the user's own zoo.

    Args:
        path: The registry that the user named. If there is none, the registry in use is taken,
            unless it is official.

    Raises:
        PublishError: The registry that was named is official.
    """
    registry = registry_path(path)
    if os.environ.get(MAKER_VARIABLE) or not _is_official_file(registry):
        return registry
    return None if path is None else refuse_official(registry)


def check_writable(data: RegistryFile, path: Path) -> None:
    """Refuse to change an official registry, unless `$ASSISTAX_ZOO_MAKER` is set.

    Raises:
        PublishError: The registry is official.
    """
    if is_official(data) and not os.environ.get(MAKER_VARIABLE):
        refuse_official(path)


def refuse_official(path: Path) -> NoReturn:
    """Raise the error for a change of an official registry."""
    raise PublishError(
        f"registry {path}",
        "a registry of your own",
        "releases of this project, which nobody else may change",
        "name another registry, or none: your own teams and splits are then kept beside it",
        "nothing was written",
    )


def _is_official_file(path: Path) -> bool:
    return not _recorded_roots(path).isdisjoint(_recorded_roots(shipped_registry()))


def _recorded_roots(path: Path) -> frozenset[str]:
    """Return the roots that a registry records; none where the file is no registry."""
    try:
        text = read_text(path, MAX_REGISTRY_BYTES, ZooError, "registry", "")
        roots = [release.get("root") for release in parse_json(text)["releases"].values()]
    except (ZooError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return frozenset()
    return frozenset(root for root in roots if isinstance(root, str))
