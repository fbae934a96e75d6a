"""Official registries: releases of this project, which only its makers may change.

A registry is official if one of its releases has the root of a release that came with this code,
under any name and in any folder. `zoo.saving` never writes to an official registry.
"""

from pathlib import Path

from assistax_base.bounded_reading import MAX_REGISTRY_BYTES, parse_json, read_text
from assistax_base.errors import ZooError
from zoo.locations import shipped_registry
from zoo.schema import RegistryFile


def is_official(data: RegistryFile) -> bool:
    """Return whether a registry holds a release that came with this code, by its root."""
    roots = {release.root for release in data.releases.values()}
    return not roots.isdisjoint(_recorded_roots(shipped_registry()))


def is_official_file(path: Path) -> bool:
    """Return whether a file is a registry with a release that came with this code."""
    return not _recorded_roots(path).isdisjoint(_recorded_roots(shipped_registry()))


def _recorded_roots(path: Path) -> frozenset[str]:
    """Return the roots that a registry records; empty if the file is no registry."""
    try:
        text = read_text(path, MAX_REGISTRY_BYTES, ZooError, "registry", "")
        roots = [release.get("root") for release in parse_json(text)["releases"].values()]
    except (ZooError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return frozenset()
    return frozenset(root for root in roots if isinstance(root, str))
