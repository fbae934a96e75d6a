"""Namespaces: publications of other zoos beside one's own, without a collision of ids.

Every key of the other registry gets `NAME:` in front: teams, egos, releases, runs, shards, splits
and disability settings, whose numbers may differ from ours.
"""

from collections.abc import Mapping
from typing import Any

from zoo.schema import RegistryFile, Split


def split_namespace(name: str) -> tuple[str, str]:
    """Return the namespace of a key, "" if it has none, and the rest."""
    namespace, _, rest = name.rpartition(":")
    return namespace, rest


def plain_name(name: str) -> str:
    """Return a key without its namespace."""
    return name.rpartition(":")[2]


def merge(own: RegistryFile, added: Mapping[str, RegistryFile]) -> RegistryFile:
    """Return a registry with others' content under their namespaces; each was validated alone."""
    tables: dict[str, Any] = {
        name: dict(getattr(own, name))
        for name in ("releases", "disability_settings", "runs", "shards", "teams", "egos")
    }
    splits = list(own.splits)
    for namespace, other in added.items():
        for name, table in tables.items():
            for key, value in getattr(other, name).items():
                table[f"{namespace}:{key}"] = _qualify(name, value, namespace)
        splits += [qualify_split(split, namespace) for split in other.splits]
    return own.model_copy(update={**tables, "splits": tuple(splits)})


def qualify_split(split: Split, namespace: str) -> Split:
    """Return a split with the namespace before its id and its teams; its sha256 is as published."""
    sides = {
        side: tuple(f"{namespace}:{team}" for team in getattr(split, side)) for side in split.sides
    }
    fields = {"id": f"{namespace}:{split.id}", "release": f"{namespace}:{split.release}"}
    return split.model_copy(update={**fields, **sides})


def _qualify(table: str, value: Any, namespace: str) -> Any:
    """Return an entry with the namespace before the keys that it refers to."""
    if table in ("teams", "egos"):
        rows = {
            role: row.model_copy(update={"shard": f"{namespace}:{row.shard}"})
            for role, row in value.policies.items()
        }
        return value.model_copy(update={"run": f"{namespace}:{value.run}", "policies": rows})
    if table == "releases":
        splits = {task: f"{namespace}:{split}" for task, split in value.splits.items()}
        return value.model_copy(update={"splits": splits})
    return value
