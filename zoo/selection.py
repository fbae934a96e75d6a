"""Choosing policies by glob and by field."""

from collections.abc import Iterable, Sequence
from typing import NoReturn

from assistax_base.errors import UnknownIdError, listing, nearest, shorten
from zoo.ids import compile_pattern
from zoo.schema import PolicyEntry

FIELDS = ("task", "algorithm", "disability", "role", "release")


def select(
    entries: Iterable[PolicyEntry],
    pattern: str | Sequence[str] | None = None,
    *,
    task: str | None = None,
    algorithm: str | None = None,
    disability: str | None = None,
    role: str | None = None,
    release: str | None = None,
) -> list[PolicyEntry]:
    """Return the entries that match, in their own order.

    Args:
        entries: Policies to choose from.
        pattern: A glob over policy ids, or several of which one must match; a glob over team ids
            takes both roles.
        task: Only this task; the same for the other fields.
        algorithm: Only this algorithm.
        disability: Only this disability setting, such as "d3".
        role: Only "robot" or "human".
        release: Only this release, such as "v1".

    Raises:
        UnknownIdError: A pattern or the fields match nothing; the nearest ids are named.
    """
    entries = list(entries)
    filters = dict(zip(FIELDS, (task, algorithm, disability, role, release), strict=True))
    chosen = entries
    for field, value in filters.items():
        chosen = chosen if value is None else _with_field(chosen, field, value)
    if pattern is None:
        return chosen or refuse_empty()
    patterns = [pattern] if isinstance(pattern, str) else list(pattern)
    # Thousands of whole ids are looked up, so that they are not matched one by one.
    named: dict[str, set[str]] = {}
    for entry in chosen:
        for name in (entry.id, entry.team):
            named.setdefault(name, set()).add(entry.id)
    keep: set[str] = set()
    for glob in dict.fromkeys(patterns):
        keep |= named.get(glob) or _matching(glob, chosen, entries)
    return [entry for entry in chosen if entry.id in keep]


def _with_field(entries: list[PolicyEntry], field: str, value: str) -> list[PolicyEntry]:
    kept = [entry for entry in entries if getattr(entry, field) == value]
    if kept:
        return kept
    present = sorted({getattr(entry, field) for entry in entries})
    raise UnknownIdError(
        f"no policy has {field} {shorten(value)}",
        f"a {field} of the policies that the other filters leave ({listing(present, 12)})",
        shorten(value),
        "use one of these; `assistax-zoo list` prints every policy",
    )


def _matching(pattern: str, entries: list[PolicyEntry], everything: list[PolicyEntry]) -> set[str]:
    matches = compile_pattern(pattern).match
    ids = {entry.id for entry in entries if matches(entry.id) or matches(entry.team)}
    if not ids and (others := [e.id for e in everything if matches(e.id) or matches(e.team)]):
        raise UnknownIdError(
            f"{shorten(pattern)} matches no policy of those that can stand here",
            f"a glob that matches such as {listing([entry.id for entry in entries], 2)}",
            f"{len(others)} others, such as {others[0]}",
        )
    return ids or refuse_unknown(pattern, [entry.id for entry in entries or everything])


def refuse_unknown(name: str, known: Sequence[str], what: str = "policy") -> NoReturn:
    """Raise the error for an id or glob without a match, which names the nearest known ids."""
    close = nearest(name, known)
    if set(name) & set("*?["):  # the algorithms that there are say more than names that look alike
        task = name.partition("/")[0]
        kinds = sorted(
            {id.split("/")[1].split("-")[0] for id in known if id.startswith(f"{task}/")}
        )
        close = [f"{task}/{kind}-*" for kind in kinds[:8]] or close
    raise UnknownIdError(
        f"unknown {what} {shorten(name)}",
        f"an id or glob that matches one of the {len(known)} candidates",
        "no match",
        f"nearest: {', '.join(close)}" if close else "",
    )


def refuse_empty() -> NoReturn:
    """Raise the error for a registry without policies."""
    raise UnknownIdError(
        "no policies to select from",
        "a registry with at least one policy",
        "an empty one",
        "publish a population with `assistax-zoo publish`",
    )
