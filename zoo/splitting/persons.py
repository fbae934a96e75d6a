"""Which persons a user asks for: their side, their ids, and how many."""

from collections.abc import Sequence

from assistax_base.digest import sha256
from assistax_base.errors import UnknownIdError, nearest
from zoo.ids import PERSONS, names_persons
from zoo.persons.registered import VALIDATION, known_persons, person_split, select_persons
from zoo.schema import PolicyEntry, RegistryFile, Split
from zoo.splitting.sides import SIDES

MOST = 200  # persons of a side, where nobody says how many: a command then takes minutes


def asks_for_persons(split: str | None, patterns: str | Sequence[str] | None) -> bool:
    """Return whether persons are meant, by a split's name or by all patterns over partners.

    Raises:
        ValueError: Persons stand beside other partners, or a pattern can be of no partner.
    """
    texts = [patterns] if isinstance(patterns, str) else list(patterns or ())
    named = [text for text in texts if text == PERSONS or names_persons(text)]
    others = [text for text in texts if text not in named]
    if odd := [text for text in others if not set(text) & set("/*?[")]:
        near = ", ".join(nearest(odd[0], [PERSONS])) or "an id of `assistax-zoo list`"
        meant = f"split {odd[0]!r}" if ":" in odd[0] else near
        raise ValueError(
            f"partners are {odd[0]!r}; allowed are {PERSONS!r}, and ids and globs over partners, "
            f"such as 'scratch/ippo-d9-*'; did you mean {meant}?"
        )
    if named and others:
        raise ValueError(
            f"partners are {named[0]!r} beside {others[0]!r}; persons have their own preferences, "
            "so play them in a separate job"
        )
    return bool(named) or PERSONS in (split or "")


def choose_persons(
    data: RegistryFile,
    task: str,
    split: str | None,
    patterns: str | Sequence[str] | None,
    most: int | None = None,
) -> tuple[Split, list[PolicyEntry]]:
    """Return the split that is meant, and the persons of its side that are to be played.

    Args:
        data: The registry.
        task: Whose persons.
        split: A side (test, validation, train, both), by default test, or of globs both; a split of
            persons, or its beginning; or both, as "persons:validation".
        patterns: "persons", or globs over persons.
        most: How many of those that match; which is a draw that does not depend on how many, and
            fewer are a part of more.

    Raises:
        ValueError: There is no such side, or no such person on it.
        ZooError: The registry has no persons of the task, or not unchanged.
    """
    texts = [patterns] if isinstance(patterns, str) else list(patterns or ())
    globs = [text for text in texts if text != PERSONS]
    name, side = _parsed(split, default="both" if globs else "test")
    named = {entry.team: entry.release for entry in select_persons(data, globs)} if globs else {}
    if len({*named.values()}) == 1 and name in (PERSONS, f"{PERSONS}-{VALIDATION}"):
        # That of their own release, which may not be the newest.
        namespace, colon, release = min(named.values()).rpartition(":")
        name = f"{namespace}{colon}{name}-s0-{release}"
    if (dealt := person_split(data, task, name)) is None:
        raise ValueError(f"split {split!r} has no persons; name {PERSONS}, or one of its sides")
    wanted = [
        team for of in SIDES[side] for team in getattr(dealt, of) if not globs or team in named
    ]
    if len(wanted) < (most or 1):
        raise UnknownIdError(
            f"persons {', '.join(globs)}" if globs else f"{most} persons",
            f"persons on the {side} side of {dealt.id}",
            f"{len(wanted) or 'none'} that match",
            f"choose fewer, others, or another side: {', '.join(SIDES)}",
        )
    drawn = sorted(wanted, key=lambda team: sha256(team.encode()))[: MOST if most is None else most]
    return dealt, known_persons(data, sorted(f"{team}/human" for team in drawn))


def _parsed(text: str | None, default: str) -> tuple[str, str]:
    """Return a split's name and a side of it, of what a user says."""
    name, _, side = (text or "").rpartition(":")
    if side not in SIDES:
        name, side = text or "", default
    if side == VALIDATION:
        namespace = name.rpartition(":")[0] + ":" * (":" in name)
        return f"{namespace}{PERSONS}-{VALIDATION}", "test"
    return name or PERSONS, side
