"""Parts of an unfinished job: one Parquet file for each finished chunk.

A part's name ends in the sha256 of its bytes. Its metadata holds the job's key, which is the digest
of the job's identity and covers all parameters. So a part of another job is refused under any name.
A damaged part is simulated again.
"""

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.bounded_reading import parse_json
from assistax_base.digest import sha256
from assistax_base.errors import counted, printable
from assistax_base.files import METADATA_KEY
from assistax_base.parquet import check_readable, read_metadata
from evaluation.play.tiles import Chunk
from evaluation.record import manifest as provenance
from evaluation.record import tables

PARTS_FOLDER = "parts"


def label(job: str) -> dict[str, str]:
    """Return the Parquet metadata of this process's parts: the job's key and this machine."""
    content = {"job": job, "made_with": provenance.describe_machine()}
    return {METADATA_KEY: json.dumps(content)}


def write_part(rows: pl.DataFrame, folder: Path, chunk: Chunk, metadata: dict[str, str]) -> None:
    """Write a chunk's episodes with metadata of `label` under a name that ends in their hash."""
    data = tables.parquet_bytes(rows, metadata)
    tables.write_bytes(data, folder / PARTS_FOLDER / f"{chunk.name}-{sha256(data)}.parquet")


def has_parts(folder: Path) -> bool:
    """Return whether a folder holds a part of any job."""
    return next(_names(folder, "part-*"), None) is not None


def check_parts(folder: Path, job: str) -> None:
    """Check that a folder's parts are of this job, and remove damaged parts.

    Args:
        folder: The job's folder.
        job: The job's digest.

    Raises:
        ValueError: A part has another key or lacks a key.
    """
    check_readable(paths := _whole(_names(folder, "part-*.parquet")))
    keys = {path: _metadata(path).get("job") for path in paths}
    strange = [path for path, key in keys.items() if key != job]
    if strange:
        raise ValueError(_refusal(strange, keys[strange[0]], job))


def find_part(folder: Path, chunk: Chunk, job: str) -> Path | None:
    """Return the path of a chunk's part, or None if there is none. A damaged part is removed.

    Args:
        folder: The job's folder.
        chunk: The chunk.
        job: The job's digest.

    Raises:
        ValueError: The part is of another job, or there are two parts with different episodes.
    """
    found = _whole(_names(folder, f"{chunk.name}-*.parquet"))
    for path in found:
        if (key := _metadata(path).get("job")) != job:
            raise ValueError(_refusal([path], key, job))
    if len(found) > 1:
        raise ValueError(
            f"{found[0]} and {found[1].name} are the same part of the job with other episodes, as "
            "of two processors; remove one of them, or both to simulate it again"
        )
    return found[0] if found else None


def merge_parts(paths: Sequence[Path]) -> tuple[pl.DataFrame, dict[str, Any]]:
    """Return the episodes of all parts, and the description of the machine that made them.

    If there were several machines, the description is {"machines": [...]}.
    """
    made: list[Any] = [_metadata(path).get("made_with") for path in paths]
    machines = [machine for place, machine in enumerate(made) if machine not in made[:place]]
    table = pl.concat([tables.read_parquet(path) for path in paths])
    return table, machines[0] if len(machines) == 1 else {"machines": machines}


def _names(folder: Path, pattern: str) -> Iterator[Path]:
    return iter(sorted((folder / PARTS_FOLDER).glob(pattern)))


def _whole(paths: Iterable[Path]) -> list[Path]:
    """Return the paths of undamaged parts, and remove damaged parts."""
    whole = []
    for path in paths:
        if path.stem.rpartition("-")[2] == provenance.file_sha256(path):
            whole.append(path)
        else:
            path.unlink()
    return whole


def _metadata(path: Path) -> Mapping[str, Any]:
    """Return a part's metadata, or an empty mapping if it is missing or malformed."""
    content: Any = None
    with contextlib.suppress(ValueError, RecursionError):
        content = parse_json(read_metadata(path).get(METADATA_KEY, "{}"))
    return content if isinstance(content, dict) else {}


def _refusal(paths: Sequence[Path], key: Any, job: str) -> str:
    owner = f"of the job {printable(str(key)[:12])}" if key else "without a job's key"
    return (
        f"{counted(len(paths), 'part')} {owner}, this job is {job[:12]}, first {paths[0]}: other "
        "policies, settings or versions played them; move them into a folder of their own job, or "
        "remove them, and they are simulated again"
    )
