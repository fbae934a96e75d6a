"""Changes of another zoo since it was last read: a rewritten history is refused, others are shown.

A zoo grows by entries, and may then give a task another default split or release. Evaluations with
its defaults then give other figures, so a user has to accept such a change.
"""

from collections.abc import Callable, Sequence

from assistax_base.errors import IntegrityError, UpdateError, listing
from zoo.history.merkle import lost_leaves
from zoo.registry import Registry
from zoo.schema import RegistryFile, Split

Accept = Callable[[Sequence[str]], bool]  # given the changes; returns whether they are taken


def take_none(changes: Sequence[str]) -> bool:
    """Accept no change."""
    return False


def check_update(old: Registry, new: Registry, source: str, accept: Accept = take_none) -> None:
    """Check that a zoo still has all that it had, and that its changes are accepted.

    Args:
        old: The registry of before.
        new: The registry of now.
        source: Name of the zoo's remote.
        accept: Called with the changes if there are any.

    Raises:
        IntegrityError: Something that was published is gone or changed.
        UpdateError: Changes are not accepted; the error lists them.
    """
    kept = "nothing was fetched; the registry of before is kept"
    if lost := lost_leaves(old.data, new.data):
        roots = [f"{release} {old.root(release)[:12]}" for release in old.data.releases]
        raise IntegrityError(
            f"registry.json of {source}",
            f"all that it published before (roots {', '.join(roots)}): published bytes never "
            "change",
            f"another history: {listing(lost)} gone or changed",
            f"ask its owner; to believe the new one, delete {old.path}",
            kept,
        )
    changed = changes(old.data, new.data)
    if changed and not accept(changed):
        refuse_changes(source, changed)


def refuse_changes(source: str, changed: Sequence[str]) -> None:
    """Raise the error for changes that were not accepted."""
    raise UpdateError(
        f"registry.json of {source}", "the state in which it was last read", "; ".join(changed)
    )


def changes(old: RegistryFile, new: RegistryFile) -> list[str]:
    """Return sentences on a registry's changes other than additions; empty without any."""
    changed = []
    if new.release != old.release:
        changed.append(f"the default release is {new.release}, was {old.release}")
    for name, release in old.releases.items():
        now = new.releases[name]
        for task in sorted({*release.splits, *now.splits}):
            before, after = _default(old, name, task), _default(new, name, task)
            if before != after:
                changed.append(f"the default split of {task} in {name} is {after}, was {before}")
        changed += [
            f"{field} of {name} is {getattr(now, field)!r}, was {getattr(release, field)!r}"
            for field in ("date", "description", "citation")
            if getattr(now, field) != getattr(release, field)
        ]
    return changed + [
        f"disability setting {name} is another"
        for name, setting in old.disability_settings.items()
        if new.disability_settings.get(name) != setting
    ]


def _default(data: RegistryFile, release: str, task: str) -> str:
    name = data.releases[release].splits.get(task)
    split: Split | None = next((split for split in data.splits if split.id == name), None)
    if split is None:
        return "none"
    return f"{split.id} ({len(split.train)} train, {len(split.test)} test)"
