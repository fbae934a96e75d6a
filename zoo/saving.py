"""Writing of registries: never against their history, and as text laid out for small diffs.

Only the makers of official registries write to them. Other users publish to a registry of their
own, or to the user's own zoo (`zoo.locations.own_registry`).
"""

import json
import os
from pathlib import Path
from typing import Any, NoReturn

from assistax_base.errors import ImmutableError, PublishError, listing
from assistax_base.files import ANYBODY, OWNER, atomic_write
from zoo.history.merkle import lost_leaves, with_roots
from zoo.history.official import is_official, is_official_file
from zoo.history.own_splits import SplitsFile, read_splits
from zoo.ids import parse_team
from zoo.locations import own_splits_file, registry_path, write_errors
from zoo.registry import Registry, build_registry, parse_registry, read_registry
from zoo.schema import RegistryFile, Split

MAKER_VARIABLE = "ASSISTAX_ZOO_MAKER"  # set by the makers of official releases
_WIDTH = 190  # of a line of the file


def save_registry(data: RegistryFile, path: Path) -> Registry:
    """Write the content with its roots, atomically, and return it as a registry.

    It is validated once more as text, and compared with the file's earlier publications.

    Raises:
        RegistryError: It would not load.
        ImmutableError: Something that was published is gone or changed.
        PublishError: The file holds an official release.
    """
    data = with_roots(data)
    text = dump_registry(data)
    registry = build_registry(parse_registry(text, str(path)), path)
    if path.exists():
        before = read_registry(path).data
        check_writable(before, path)
        check_grown(before, registry.data)
    has_secret = any(table.secret for r in data.releases.values() for table in r.persons.values())
    atomic_write(path, text.encode(), OWNER if has_secret else ANYBODY)
    return registry


def check_grown(old: RegistryFile, new: RegistryFile) -> None:
    """Check that a registry holds all that it published before.

    Raises:
        ImmutableError: An entry, a split or a setting is gone or changed.
    """
    if lost := lost_leaves(old, new):
        raise ImmutableError(
            "registry",
            "all that was published, unchanged",
            f"{listing(lost)} gone or changed",
            "publish under a new release",
            "nothing was written, because published data never changes",
        )


def keep_split(split: Split) -> None:
    """Add a split to the user's own, under `assistax_base.files.exclusive(own_splits_file())`."""
    kept = {own.id: own for own in read_splits()} if own_splits_file().is_file() else {}
    if kept.get(split.id) == split:
        return
    content = SplitsFile(splits=(*kept.values(), split)).model_dump(mode="json")
    text = json.dumps(content, indent=1) + "\n"
    with write_errors(own_splits_file(), len(text)):
        atomic_write(own_splits_file(), text.encode())


def writable_registry(path: Path | str | None = None) -> Path | None:
    """Return the registry that a publication goes to; None for the user's own zoo.

    Args:
        path: The registry that the user named. If there is none, the registry in use is taken,
            unless it is official.

    Raises:
        PublishError: The registry that was named is official.
    """
    registry = registry_path(path)
    if os.environ.get(MAKER_VARIABLE) or not is_official_file(registry):
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
        "releases of this project, which only its makers may change",
        "name another registry, or leave it out to keep your teams and splits in your own zoo",
        "nothing was written",
    )


def dump_registry(file: RegistryFile) -> str:
    """Return the registry's text: sorted, one line for each small object, for small diffs."""
    data = file.model_dump(mode="json", exclude_defaults=True)
    for table in ("teams", "egos"):
        names = sorted(data.get(table, {}), key=lambda text: parse_team(text).order)
        data |= {table: {name: data[table][name] for name in names}} if names else {}
    data.setdefault("teams", {})
    for table in ("releases", "runs", "shards"):
        data[table] = dict(sorted(data[table].items()))
    data["splits"] = sorted(data.get("splits", []), key=lambda split: split["id"])
    return _lay_out(data, 0) + "\n"


def _lay_out(value: Any, indent: int) -> str:
    """Return JSON: a container on one line where it fits and is shallow, else one item a line."""
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if (
        not isinstance(value, dict | list)
        or not value
        or (indent and _shallow(value) and len(flat) + indent <= _WIDTH)
    ):
        return flat
    inner = " " * (indent + 1)
    if isinstance(value, list):
        items = [inner + _lay_out(item, indent + 1) for item in value]
    else:
        items = [
            f"{inner}{json.dumps(key)}: {_lay_out(item, indent + 1)}" for key, item in value.items()
        ]
    opening, closing = ("[", "]") if isinstance(value, list) else ("{", "}")
    return opening + "\n" + ",\n".join(items) + "\n" + " " * indent + closing


def _shallow(value: Any) -> bool:
    """Return whether a container holds scalars only, or one short list as well."""
    items = value.values() if isinstance(value, dict) else value
    return all(
        not isinstance(item, dict) and (not isinstance(item, list) or len(item) <= 4)
        for item in items
    )
