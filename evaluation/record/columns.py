"""The columns of an episode table: their types, the tables that have them, and validation.

A table has one row an episode. Every metric is computed from it.
"""

import dataclasses
from typing import Literal

import polars as pl

from assistax_envs.preferences import VALUES

SIDES = ("train", "validation", "test")
TERM_PREFIX = "term_"  # of the reward terms (`term_<name>`, Float32), which differ by task
VIOLATIONS = ("none", "impact", "pressed")  # kinds, in the order of their numbers in `care`
METRIC_PREFIX = "metric_"  # of the columns of installed packages (`metric_<name>`, Float32)

# Tables that have a column: with behaviour (all since manifest format 2), of gentle tasks, of tasks
# whose version measures contact with people, of tasks whose version measures care, of series of
# episodes, of robots from outside.
Family = Literal["behaviour", "gentle", "touch", "care", "series", "outside"]


@dataclasses.dataclass(frozen=True)
class Column:
    """Type of a column, and the tables that have it."""

    dtype: pl.DataType
    family: Family | None = None  # the tables that have it; None if all have it
    nullable: bool = False  # such as the algorithm, which is unknown for an ego from outside


_TEXT, _WHOLE, _REAL, _FLAG = pl.String(), pl.Int64(), pl.Float32(), pl.Boolean()
# Of each wish of the task, in its unit: what the person likes; what was done of it, the geometric
# mean over seconds 10 to 20 while it was judged; the share of these steps within a factor 1.5 of
# what is liked. The last two are null where it was never judged then.
_WISHES = {
    f"{prefix}_{wish}": Column(_REAL, "care", nullable=prefix != "liked")
    for wish in VALUES
    for prefix in ("liked", "done", "within")
}
COLUMNS = {
    "ego": Column(_TEXT),
    "ego_team": Column(_TEXT, nullable=True),
    "ego_algorithm": Column(_TEXT, nullable=True),
    "ego_disability": Column(_TEXT, nullable=True),
    "ego_seed": Column(_WHOLE, nullable=True),
    "partner": Column(_TEXT),
    "partner_team": Column(_TEXT, nullable=True),
    "partner_algorithm": Column(_TEXT, nullable=True),
    "partner_disability": Column(_TEXT, nullable=True),
    "partner_seed": Column(_WHOLE, nullable=True),
    "side": Column(_TEXT, nullable=True),
    "episode": Column(_WHOLE),
    "place": Column(_WHOLE, "series"),  # of the episode in its series, from 1
    "preference": Column(_TEXT, "gentle"),
    "key": Column(_WHOLE),
    "return": Column(_REAL),
    "discounted_return": Column(_REAL),
    "success": Column(_FLAG),  # of care, if the task's version measures that
    "force_mean": Column(_REAL),
    "force_peak": Column(_REAL),
    "contact_peak": Column(_REAL, "gentle"),  # N, of one contact
    "violated": Column(_FLAG, "gentle"),  # one was above the hard limit
    "end_share": Column(_REAL, "touch"),  # of steps: touched with a joint of the arm at its end
    # m/s of the tool in the step before the first touch; 0 without a touch
    "touch_speed": Column(_REAL, "touch"),
    "face_least": Column(_REAL, "touch"),  # m, the tool's least distance from the face
    "together_peak": Column(_REAL, "touch"),  # N, the largest sum of contacts at once
    "sustained_force": Column(_REAL, "touch"),  # N, the largest mean over 1 s of all contacts
    **_WISHES,
    "discomfort_share": Column(_REAL, "care"),  # of felt steps
    "violation": Column(_TEXT, "care"),  # one of VIOLATIONS
    "first_contact": Column(_WHOLE, "behaviour"),  # steps until it; all steps without a contact
    "distance_mean": Column(_REAL, "behaviour"),
    "robot_travel": Column(_REAL, "behaviour"),  # rad, summed over joints and steps
    "human_travel": Column(_REAL, "behaviour"),
    "nonfinite": Column(_FLAG),
    "steps": Column(_WHOLE),
    # Share of the numbers of a robot from outside that were beyond [-1, 1]; null of other robots.
    "clipped": Column(_REAL, "outside", nullable=True),
}
SCHEMA = {name: column.dtype for name, column in COLUMNS.items()}
BEHAVIOUR, GENTLE, TOUCH, CARE = (
    tuple(name for name, column in COLUMNS.items() if column.family == family)
    for family in ("behaviour", "gentle", "touch", "care")
)
# Names of the columns about contact with people, in tables for readers.
TOUCHES = {
    "end_share": "touched with a joint at its end, share of steps",
    "touch_speed": "speed at the first touch, m/s",
    "face_least": "least distance of the tool from the face, m",
    "together_peak": "largest sum of contacts at once, N",
    "sustained_force": "largest mean of all contacts over 1 s, N",
}
EGO_COLUMNS = tuple(name for name in COLUMNS if name.startswith("ego"))
PARTNER_COLUMNS = (*(name for name in COLUMNS if name.startswith("partner")), "side")
_OUTCOMES = (
    *("success", "discomfort_share", "violated", "force_mean", "force_peak", "contact_peak"),
    *TOUCH,
)


def term_columns(table: pl.DataFrame) -> tuple[str, ...]:
    """Return the names of the reward-term columns, in the table's order."""
    return tuple(name for name in table.columns if name.startswith(TERM_PREFIX))


def metric_columns(table: pl.DataFrame) -> tuple[str, ...]:
    """Return the names of the columns that packages added, in the table's order."""
    return tuple(name for name in table.columns if name.startswith(METRIC_PREFIX))


def measures_care(table: pl.DataFrame) -> bool:
    """Return whether success in a table is caring success."""
    return "discomfort_share" in table.columns


def wishes_of(table: pl.DataFrame) -> tuple[str, ...]:
    """Return the names of the wishes of a table's task."""
    return tuple(wish for wish in VALUES if f"done_{wish}" in table.columns)


def outcome_columns(table: pl.DataFrame) -> tuple[str, ...]:
    """Return the table's columns of outcomes other than the return, such as success and force."""
    known = (name for name in _OUTCOMES if name in table.columns)
    return (*known, *metric_columns(table))


def validate_episodes(table: pl.DataFrame) -> pl.DataFrame:
    """Return the table unchanged.

    Raises:
        ValueError: A column is missing, unknown or of another type, or a value is not allowed.
    """
    needed = [name for name, column in COLUMNS.items() if column.family is None]
    missing = [name for name in needed if name not in table.columns]
    if missing:
        raise ValueError(
            f"the episode table lacks the columns {', '.join(missing)}; it needs all of "
            f"{', '.join(needed)}"
        )
    prefixes = TERM_PREFIX, METRIC_PREFIX
    unknown = [
        name for name in table.columns if name not in COLUMNS and not name.startswith(prefixes)
    ]
    if unknown:
        raise ValueError(
            f"the episode table has unknown columns {', '.join(unknown)}; reward terms begin with "
            "term_, columns of packages with metric_"
        )
    if table.is_empty():
        raise ValueError("the episode table has no rows; at least one episode is needed")
    for name in table.columns:
        _validate_column(table, name, COLUMNS.get(name, Column(_REAL)))
    _validate_values(table, "side", SIDES)
    if "violation" in table.columns:
        _validate_values(table, "violation", VIOLATIONS)
    return table


def _validate_values(table: pl.DataFrame, name: str, allowed: tuple[str, ...]) -> None:
    found = table[name].drop_nulls().unique().sort()
    if strange := [value for value in found if value not in allowed]:
        null = " and null" * COLUMNS[name].nullable
        raise ValueError(
            f"column {name} holds {', '.join(map(repr, strange))}; allowed are "
            f"{', '.join(map(repr, allowed))}{null}"
        )


def _validate_column(table: pl.DataFrame, name: str, expected: Column) -> None:
    column = table[name]
    if column.dtype == pl.Null and expected.nullable:
        return
    if not _same_family(column.dtype, expected.dtype):
        raise ValueError(f"column {name} is {column.dtype}; expected {expected.dtype}")
    if not expected.nullable and column.null_count():
        raise ValueError(
            f"column {name} has {column.null_count()} empty values; every episode needs one"
        )
    if expected.dtype.is_float():
        bad = table.filter(~column.is_finite())
        if bad.height:
            ego, partner, episode, value = bad.select("ego", "partner", "episode", name).row(0)
            raise ValueError(
                f"column {name} has {bad.height} values that are not finite, first {value} for ego "
                f"{ego} with {partner}, episode {episode}; a broken episode must be frozen at "
                "reward 0 and marked nonfinite"
            )


def _same_family(dtype: pl.DataType, expected: pl.DataType) -> bool:
    whole, real = dtype.is_integer() and expected.is_integer(), dtype.is_float()
    return dtype == expected or whole or (real and expected.is_float())
