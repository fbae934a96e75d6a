"""Ids of persons: `task/person-NNNNN-vR`, of five digits, and the words that go with them."""

import re

PERSON = "person"
PERSONS = "persons"  # names the kind, and begins the names of its splits
OWN = "own"  # in place of a disability setting
_NUMBER = r"(?:0|[1-9][0-9]{0,9})"
_NAME = r"[a-z][a-z0-9_]{0,31}"
_PERSON = re.compile(
    rf"(?:(?P<namespace>{_NAME}):)?(?P<task>{_NAME})/person-(?P<number>[0-9]{{5}})"
    rf"-(?P<release>v{_NUMBER})(?:/human)?"
)


def is_team(name: str) -> bool:
    """Return whether an id, with or without a role, is no person's."""
    return f"/{PERSON}-" not in name


def parse_person(text: str) -> tuple[str, str, int, str] | None:
    """Return namespace, task, number and release of a person's id; None for any other text."""
    match = _PERSON.fullmatch(text)
    if match is None:
        return None
    return match["namespace"] or "", match["task"], int(match["number"]), match["release"]
