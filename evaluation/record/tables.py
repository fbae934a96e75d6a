"""Names of the files of a finished folder, and reading and writing of Parquet and JSON."""

import dataclasses
import errno
import io
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base import parquet
from assistax_base.bounded_reading import parse_json
from assistax_base.files import atomic_write
from evaluation.record.columns import (
    SCHEMA,
    metric_columns,
    term_columns,
    validate_episodes,
)

# Names of the files in the folder that an evaluation or a cross-play fills.
EPISODES_FILE = "episodes.parquet"  # one row an episode
PAIRS_FILE = "pairs.parquet"  # one row an (ego, partner) pair: the cross-play matrix in long form
REFERENCES_FILE = "references.parquet"  # episodes of the reference egos
BOUNDS_FILE = "bounds.parquet"  # low and best return of each partner, with their sources
PARTNERS_FILE = "partners.parquet"  # one row a partner, averaged over the egos
PROFILE_FILE = "profile.parquet"  # performance profile of an evaluation
ORDER_FILE = "order.json"  # clustered order of a cross-play matrix
STRATEGIES_FILE = "strategies.json"  # partners of a cross-play by behaviour
RUN_FILE = "run.json"  # command, machine and versions
SUMMARY_FILE = "summary.json"  # the object that --json prints
MATRIX_FIGURE = "crossplay.png"  # the clustered matrix, drawn
FILES = (
    *(EPISODES_FILE, PAIRS_FILE, REFERENCES_FILE, BOUNDS_FILE, PARTNERS_FILE, PROFILE_FILE),
    *(ORDER_FILE, STRATEGIES_FILE, RUN_FILE, SUMMARY_FILE, MATRIX_FIGURE),
)
# Made from the episodes by the last command, with its options.
DERIVED_FILES = tuple(name for name in FILES if name not in (EPISODES_FILE, RUN_FILE))

OPTIONAL = "left out if empty"  # of a dataclass's field, see `to_json`
LARGEST_JSON = 1 << 26  # bytes of a readable file, 30 times those of a matrix of all teams


def write_episodes(table: pl.DataFrame, path: Path) -> None:
    """Validate a table, cast it to the types of `SCHEMA` and write it atomically."""
    validate_episodes(table)
    numbers = *term_columns(table), *metric_columns(table)
    types = {**SCHEMA, **dict.fromkeys(numbers, pl.Float32())}
    write_parquet(table.select(pl.col(name).cast(types[name]) for name in table.columns), path)


def read_episodes(path: Path) -> pl.DataFrame:
    """Return the validated episode table of a file."""
    return validate_episodes(read_parquet(path))


def write_parquet(table: pl.DataFrame, path: Path) -> None:
    """Write a table as Parquet, atomically."""
    write_bytes(parquet_bytes(table), path)


def parquet_bytes(table: pl.DataFrame, metadata: dict[str, str] | None = None) -> bytes:
    """Return a table as the bytes of a Parquet file.

    They are made in memory, because on a full disk the error of Polars is misleading.
    """
    content = io.BytesIO()
    table.write_parquet(content, compression="zstd", metadata=metadata)
    return content.getvalue()


def read_parquet(path: Path) -> pl.DataFrame:
    """Return the table of a Parquet file; errors about a missing or damaged file name its path."""
    _check_there(path)
    parquet.check_size(path)
    return parquet.read_parquet(path)


def write_bytes(data: bytes, path: Path) -> None:
    """Write a file atomically; raise an OSError with advice if the disk is full."""
    try:
        atomic_write(path, data)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(
            f"the disk is full: {path} needs {len(data)} bytes; free some space, then repeat the "
            "command; it continues"
        ) from None


def remove_derived(folder: Path, but: Collection[str] = ()) -> None:
    """Remove the tables and figures made from a folder's episodes, except the names in `but`."""
    for name in set(DERIVED_FILES).difference(but):
        (folder / name).unlink(missing_ok=True)


def to_json(value: Any) -> Any:
    """Return a value that `json.dumps` accepts: dataclasses become objects, tuples lists.

    A field whose metadata has `OPTIONAL` is left out if it is empty.
    """
    if dataclasses.is_dataclass(value):
        return {
            field.name: to_json(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if getattr(value, field.name) or not field.metadata.get(OPTIONAL)
        }
    if isinstance(value, Mapping):
        return {name: to_json(item) for name, item in value.items()}
    return [to_json(item) for item in value] if isinstance(value, (list, tuple)) else value


def write_json(content: Any, path: Path) -> None:
    """Write JSON without NaN or infinity, atomically."""
    text = json.dumps(to_json(content), indent=2, allow_nan=False)
    write_bytes((text + "\n").encode(), path)


def read_json(path: Path) -> dict:
    """Return the JSON object of a file; errors about a missing or damaged file name its path."""
    _check_there(path)
    try:
        if (size := path.stat().st_size) > LARGEST_JSON:
            raise ValueError(f"it has {size} bytes; at most {LARGEST_JSON} are read")
        content = parse_json(path.read_text(encoding="utf-8"), LARGEST_JSON)
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"{path} is not readable JSON ({error}); delete it and run again"
        ) from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds a {type(content).__name__}; expected an object")
    return content


def _check_there(path: Path) -> None:
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} does not exist; run an evaluation or a cross-play into this folder first"
        )
