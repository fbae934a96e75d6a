"""Check that jobs were played alike, by their identities in the folders' manifests.

Figures of several folders are comparable only if the same partners played under the same
conditions. Every command that combines folders uses these checks.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from assistax_base.errors import printable, shorten
from evaluation.record.manifest import MANIFEST_FILE, identity_digest, read_manifest

SOFTWARE = "software"
COLUMNS = "columns"  # that packages added: they tell more, and change no episode
# The columns of an identity's rows of policies, after the id.
SEATS = {"egos": ("digest",), "partners": ("disability", "side", "digest", "setting")}
ADVICE = "play both alike"

Described = Mapping[str, Mapping[str, Any]]  # by the folder's name


def read_identity(folder: Path) -> dict[str, Any] | None:
    """Return the identity of a folder's job, or None if no manifest has one.

    Raises:
        ValueError: The manifest was changed, or its digest is not that of its identity.
    """
    manifest = read_manifest(folder) or {}
    identity = manifest.get("identity")
    if identity is None:
        return None
    if not isinstance(identity, dict) or manifest.get("job") != identity_digest(identity):
        raise ValueError(
            f"{folder / MANIFEST_FILE} names another job than the identity it holds; take the "
            "folder from where it was made"
        )
    return identity


def conditions(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return the conditions of a job: its identity without policies, software and columns."""
    apart = *SEATS, SOFTWARE, COLUMNS
    return {name: value for name, value in identity.items() if name not in apart}


def check_alike(
    described: Described, fields: Iterable[str] | None = None, *, advice: str = ADVICE
) -> None:
    """Check that folders are equal in all fields; a missing field differs from any value.

    Args:
        described: JSON-ready fields of each folder, by the folder's name, such as `conditions`.
        fields: The fields that must be equal; by default all.
        advice: The last part of the error message.

    Raises:
        ValueError: Names the first field that differs, both values and both folders.
    """
    names = list(described)
    if fields is None:
        fields = dict.fromkeys(field for values in described.values() for field in values)
    for field in fields:
        values = [(name, described[name].get(field)) for name in names]
        for value in values[1:]:
            _check_equal(field, [values[0], value], advice)


def check_members(identities: Described, seat: str, *, advice: str = ADVICE) -> None:
    """Check that an id is the same policy, with the same setting and side, in all jobs.

    Args:
        identities: The jobs' identities, by the folder's name.
        seat: "egos" or "partners".
        advice: The last part of the error message.

    Raises:
        ValueError: Names the policy, what differs, both values and both folders.
    """
    known: dict[str, tuple[str, list[Any]]] = {}
    for name, identity in identities.items():
        for policy, row in _members(name, identity, seat).items():
            first, expected = known.setdefault(policy, (name, row))
            for column, *values in zip(SEATS[seat], expected, row, strict=True):
                what = f"{column} of {seat.removesuffix('s')} {policy}"
                _check_equal(what, list(zip((first, name), values, strict=True)), advice)


def software_notes(made_with: Described) -> list[str]:
    """Return notes on versions or processors that differ, so that returns may differ too.

    Args:
        made_with: Each folder's versions by package name; empty if the folder has none.
    """
    known = {name: versions for name, versions in made_with.items() if versions}
    notes = []
    for package in dict.fromkeys(package for versions in known.values() for package in versions):
        found = {name: v[package] for name, v in known.items() if package in v}
        if len({_shown(version) for version in found.values()}) > 1:
            listed = ", ".join(f"{_shown(version)} in {name}" for name, version in found.items())
            notes.append(printable(f"{package} is {listed}: returns may differ for that alone"))
    return notes


def _members(name: str, identity: Mapping[str, Any], seat: str) -> dict[str, list[Any]]:
    rows, width = identity.get(seat), 1 + len(SEATS[seat])
    if not isinstance(rows, list) or not all(
        isinstance(row, list) and len(row) == width and isinstance(row[0], str) for row in rows
    ):
        raise ValueError(f"the manifest of {name} names no {seat}; run again")
    return {row[0]: row[1:] for row in rows}


def _check_equal(what: str, values: list[tuple[str, Any]], advice: str) -> None:
    (first, expected), (second, found) = values
    if expected != found:
        text = f"{what} is {_shown(expected)} in {first} and {_shown(found)} in {second}; {advice}"
        raise ValueError(printable(text))


def _shown(value: Any) -> str:
    """Return a value as short JSON text; "none" for None and for an empty list."""
    if value is None or value == []:
        return "none"
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 80 else shorten(text)
