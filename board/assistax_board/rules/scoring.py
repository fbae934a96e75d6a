"""A worker's job, the interface that plays it, and the format of its result."""

import dataclasses
import io
import json
from collections.abc import Collection
from typing import Annotated, Any, Protocol

import polars as pl
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from assistax_board.problems import Problem
from assistax_board.vocabulary import Kind
from evaluation.record.columns import CARE, SCHEMA, VIOLATIONS

# Columns of a result, in this order: nothing else leaves a worker.
COLUMNS = {
    "partner": pl.String(),
    "algorithm": pl.String(),
    "disability": pl.String(),
    "episode": pl.Int32(),
    "return": pl.Float32(),
    "success": pl.Boolean(),
    "nonfinite": pl.Boolean(),
}
OWN = "own"  # preference of a partner that brings its own
# Of the gentle tasks: the human's preference, "own" of a person; whether there was a violation, and
# of which kind; the share of felt steps with discomfort.
GENTLE_COLUMNS = {
    "preference": pl.String(),
    "violated": pl.Boolean(),
    "violation": SCHEMA["violation"],
    "discomfort_share": SCHEMA["discomfort_share"],
}
# Of each wish of the task: what was liked and done, and the share near it; see
# `evaluation.record.columns`. The last two may be empty.
WISH_COLUMNS = {name: SCHEMA[name] for name in CARE if name not in GENTLE_COLUMNS}
MAX_TABLE_BYTES = 4 * 1024 * 1024


@dataclasses.dataclass(frozen=True)
class Work:
    """One job with all that a worker needs to play it; JSON-ready."""

    job: str
    lease: str  # the lease's secret
    submission: str
    task: str
    kind: Kind
    format: str | None  # of a reference its name
    artefact: str | None  # sha256 of the robot
    release: str | None  # sha256 of the private release; None for the public panel
    version: str
    panel: str
    chunk: int
    partners: tuple[str, ...]  # ids; of a private release ordinals, such as "hidden-0007"
    episodes: int
    seed: str  # hexadecimal, up to 128 bits: JSON readers elsewhere would round it
    preferences: tuple[str, ...] = ()  # of a gentle task's humans, in turns


class Scorer(Protocol):
    """Plays the partners of a piece of work with a robot."""

    def versions(self) -> tuple[str, ...]:
        """Return the ids of the versions that this installation scores."""
        ...

    def play(self, work: Work, robot: Any, release: bytes | None) -> pl.DataFrame:
        """Return one row an episode, with the columns of `COLUMNS`.

        Args:
            work: What is played.
            robot: The file's bytes, None for a reference.
            release: The packed private release, of a hidden panel.

        Raises:
            Refusal: The robot cannot be played.
        """
        ...


class _Rows(BaseModel):
    """A result as it travels: JSON, since a reader of foreign Parquet can abort the process."""

    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)
    # Of `WISH_COLUMNS`, as pydantic types more fields.
    __pydantic_extra__: dict[str, list[float | None]] = Field(init=False)  # ty: ignore[incompatible-mutable-override]

    partner: list[str]
    algorithm: list[str]
    disability: list[str]
    episode: list[Annotated[int, Field(ge=0, lt=2**31)]]
    returns: list[float] = Field(alias="return")
    success: list[bool]
    nonfinite: list[bool]
    preference: list[str] | None = None
    violated: list[bool] | None = None
    violation: list[str] | None = None
    discomfort_share: list[Annotated[float, Field(ge=0.0, le=1.0)]] | None = None


def encode_table(table: pl.DataFrame) -> bytes:
    """Return a result as a worker sends it."""
    return json.dumps(_in_order(table).to_dict(as_series=False)).encode()


def decode_table(
    data: bytes, partners: tuple[str, ...], episodes: int, preferences: tuple[str, ...] = ()
) -> pl.DataFrame:
    """Return a result that has every episode of these partners once, and nothing else.

    Raises:
        Problem: It has not.
    """
    if len(data) > MAX_TABLE_BYTES:
        raise Problem("too_large", f"a result has at most {MAX_TABLE_BYTES} bytes")
    try:
        rows = _Rows.model_validate_json(data).model_dump(by_alias=True, exclude_none=True)
        columns = COLUMNS | (_of_gentle(rows) if preferences else {})
        if rows.keys() != columns.keys() or len(set(map(len, rows.values()))) != 1:
            raise ValueError
    except (ValidationError, ValueError):
        names = ", ".join(COLUMNS | (GENTLE_COLUMNS if preferences else {}))
        raise Problem("invalid", f"a result is JSON with the columns {names}") from None
    table = pl.DataFrame(rows, schema=columns)
    expected = {(name, episode) for name in partners for episode in range(episodes)}
    present = table.select("partner", "episode").rows()
    if len(present) != len(expected) or set(present) != expected:
        raise Problem("invalid", "the result lacks episodes of this job, or has others")
    if not table["return"].is_finite().all():
        raise Problem("invalid", "the result has returns that are not finite")
    if preferences and not set(table["preference"]) <= {*preferences, OWN}:
        raise Problem("invalid", "the result has preferences that nobody asked for")
    if preferences and not _is_care(table):
        raise Problem("invalid", "the result has violations or wishes that no episode has")
    return table


def _is_care(table: pl.DataFrame) -> bool:
    """Return whether kinds of violations are known, and what was liked, done and near is possible.

    Liked and done are above 0, the share near it is in [0, 1], and only the last two may be empty.
    """
    fits = set(table["violation"]) <= set(VIOLATIONS)
    for name in set(WISH_COLUMNS) & set(table.columns):
        values, what = table[name].drop_nulls(), name.partition("_")[0]
        low, high = (0.0, 1.0) if what == "within" else (1e-6, 1e6)
        fits &= bool(values.is_between(low, high).all())
        fits &= what != "liked" or len(values) == table.height
    return fits


def table_bytes(table: pl.DataFrame) -> bytes:
    """Return a result as Parquet with sorted rows, the same bytes for every worker."""
    buffer = io.BytesIO()
    _in_order(table).write_parquet(buffer, compression="zstd")
    return buffer.getvalue()


def _in_order(table: pl.DataFrame) -> pl.DataFrame:
    """Return the columns of a result in their types, sorted."""
    columns = COLUMNS | (_of_gentle(table.columns) if "preference" in table.columns else {})
    typed = table.select(pl.col(name).cast(kind) for name, kind in columns.items())
    return typed.sort("partner", "episode")


def _of_gentle(names: Collection[str]) -> dict[str, pl.DataType]:
    """Return the columns of a gentle task, with those of the wishes that are among the names."""
    wishes = {name.partition("_")[2] for name in names if name in WISH_COLUMNS}
    own = {f"{what}_{wish}" for what in ("liked", "done", "within") for wish in wishes}
    return GENTLE_COLUMNS | {name: kind for name, kind in WISH_COLUMNS.items() if name in own}


def cut(panel: tuple[str, ...], size: int) -> list[tuple[str, ...]]:
    """Return a panel cut into chunks of `size`; the last one may be shorter."""
    return [panel[start : start + size] for start in range(0, len(panel), size)]
