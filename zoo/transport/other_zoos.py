"""Zoos of others beside one's own: `assistax-zoo add REMOTE --as lab`.

An added zoo is a copy of its registry in the user's data folder; its parameters are fetched as any
others. It belongs to the default registry: a registry that is named stands alone.
"""

import shutil
from collections.abc import Sequence

from assistax_base.errors import IdError, UnknownIdError, listing
from assistax_base.files import atomic_write
from zoo.ids import check_name
from zoo.locations import OWN, added_registries, added_registry, added_remote, write_errors
from zoo.registry import Registry, load_registry
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import remote_registry
from zoo.transport.updates import Accept, check_update, refuse_changes, take_none

TAKEN = (OWN, "zoo", "python", "onnx")  # the user's own zoo, and prefixes of robots' names


def add(remote: str, namespace: str, accept: Accept = take_none) -> Registry:
    """Add a remote's zoo under a namespace, or bring it up to date, and return its registry.

    Args:
        remote: A folder, an address, or a hub's repository.
        namespace: Prefix of its ids.
        accept: Called with the changes since the zoo was added, if any; returns whether they are
            taken.

    Raises:
        IdError: The namespace is no lower-case name, or one that stands before a robot's name
            anyway.
        IntegrityError: The remote lost or changed entries that were added before.
        UpdateError: Changes are not accepted; the error lists them.
        ZooError: The remote has no registry, or cannot be reached.
    """
    if namespace in TAKEN:
        found = f"{namespace!r}, which the user's own zoo or a kind of robot has"
        raise IdError("namespace", "another name", found)
    path, source = added_registry(check_name("namespace", namespace)), open_remote(remote)
    accept = _once(accept)
    registry = remote_registry(source, accept)
    if path.is_file():
        before = added_remote(namespace)
        moved = [f"it comes from {source.name}, not from {before}"] if before != source.name else []
        if moved and not accept(moved):
            refuse_changes(source.name, moved)
        check_update(load_registry(path), registry, source.name, accept)
    content = registry.path.read_bytes()
    with write_errors(path, len(content)):
        atomic_write(path.with_name("remote"), source.name.encode())
        atomic_write(path, content)
    return load_registry(path)


def _once(accept: Accept) -> Accept:
    """Return a function that asks for the same changes once: two copies may lag behind."""
    accepted: list[list[str]] = []

    def ask(changes: Sequence[str]) -> bool:
        if list(changes) not in accepted and accept(changes):
            accepted.append(list(changes))
        return list(changes) in accepted

    return ask


def remove(namespace: str) -> None:
    """Forget an added zoo; fetched parameters stay in the cache.

    Raises:
        UnknownIdError: No added zoo has that name, or it is the user's own.
    """
    if namespace == OWN:
        raise UnknownIdError(
            f"zoo {namespace!r}",
            "one that was added",
            "your own, which may hold the only copy of its parameters",
            f"delete the folder {added_registry(OWN).parent} if it is not needed",
            "nothing was removed",
        )
    if namespace not in (known := added_registries()):
        raise UnknownIdError(
            f"zoo {namespace!r}",
            f"one that was added ({listing(known)})",
            "none of that name",
            "`assistax-zoo list` prints them as NAME:...",
            "nothing was removed",
        )
    shutil.rmtree(known[namespace].parent)
