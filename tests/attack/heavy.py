"""Small folders that ask for much: a few kilobytes that a careless reader makes gigabytes of."""

import io
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl

from evaluation.record import manifest as provenance
from evaluation.record import tables

Change = Callable[[Path], None]
ROWS = 50_000_000  # of a table that is small as a file, and has one column
WHOLE = 3_000_000  # of one that has all columns: a gigabyte
LARGE = (10**9, 10**15, 2**63, 10**30, -1)


def set_in(*path: str, value: Any) -> Change:
    """Return what changes one value of a manifest, which is then sealed with its own hash."""

    def change(folder: Path) -> None:
        content = provenance.read_manifest(folder) or {}
        node = content
        for name in path[:-1]:
            node = node[name]
        node[path[-1]] = value
        if path[0] == "identity":
            content["job"] = provenance.identity_digest(content["identity"])
        provenance.write_manifest(folder, content)

    return change


def sealed(name: str, content: Callable[[bytes], bytes]) -> Change:
    """Return what replaces a file of a folder, whose manifest then holds the file's hash."""

    def change(folder: Path) -> None:
        path = folder / name
        path.write_bytes(content(path.read_bytes() if path.is_file() else b""))
        provenance.seal(folder)

    return change


def more_rows(data: bytes) -> bytes:
    """Repeat the first row: every column is one run of one value."""
    first = pl.read_parquet(io.BytesIO(data)).head(1)
    return _parquet(first.select(pl.all().repeat_by(WHOLE).explode()))


def one_column(kind: pl.DataType, value: Any) -> Callable[[bytes], bytes]:
    """Return a table of one column that is ours by its name alone."""
    return lambda data: _parquet(
        pl.select(pl.repeat(value, ROWS, dtype=kind).alias("return"), eager=True)
    )


def many_columns(data: bytes) -> bytes:
    table = pl.read_parquet(io.BytesIO(data))
    extra = {f"term_{number}": pl.lit(0.0, pl.Float32) for number in range(20_000)}
    return _parquet(table.with_columns(**extra))


def long_text(data: bytes) -> bytes:
    """Name every partner by the same 20 MB of text."""
    table = pl.read_parquet(io.BytesIO(data))
    return _parquet(table.with_columns(pl.lit("x" * 20_000_000).alias("partner_algorithm")))


def many_partners(data: bytes) -> bytes:
    """Name another robot and another partner in each of 60,000 rows: the block of all is dense."""
    table = pl.read_parquet(io.BytesIO(data)).head(1)
    table = table.select(pl.all().repeat_by(60_000).explode())
    names = pl.int_range(table.height).cast(pl.String)
    return _parquet(table.with_columns(ego="e" + names, partner="p" + names))


def far_episodes(data: bytes) -> bytes:
    table = pl.read_parquet(io.BytesIO(data))
    return _parquet(table.with_columns(pl.col("episode") + 10**12))


def deep(data: bytes) -> bytes:
    return b'{"a":' * 100_000 + b"1" + b"}" * 100_000


def long_number(data: bytes) -> bytes:
    return b'{"episodes": ' + b"9" * 5_000_000 + b"}"


def many_zeros(data: bytes) -> bytes:
    return b'{"m_test": [' + b"0," * 30_000_000 + b"0]}"


def long_notes(data: bytes) -> bytes:
    content = json.loads(data)
    return json.dumps({**content, "notes": ["x" * 1000] * 100_000}).encode()


def blank(data: bytes) -> bytes:
    return b" " * 200_000_000 + data


def wide_picture(data: bytes) -> bytes:
    """Return a picture of 60,000 by 60,000 black points, 4 MB of PNG."""
    size = 60_000

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content))
            + kind
            + content
            + struct.pack(">I", zlib.crc32(kind + content))
        )

    squeeze = zlib.compressobj(9)
    row = bytes(1 + size // 8)
    points = b"".join(squeeze.compress(row) for _ in range(size)) + squeeze.flush()
    head = struct.pack(">IIBBBBB", size, size, 1, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", points) + chunk(b"IEND", b"")
    )


def many_files(folder: Path) -> None:
    """Name one file by 40 paths, and 20,000 that are not there."""
    target = folder / tables.EPISODES_FILE
    names = [str(folder / ("./" * depth) / target.name) for depth in range(1, 41)]
    names += [f"/nowhere/{number}" for number in range(20_000)]
    set_in("sources", "files", value=dict.fromkeys(names, provenance.file_sha256(target)))(folder)


def named(*paths: str) -> Change:
    return set_in("sources", "files", value=dict.fromkeys(paths, "0" * 64))


def changes() -> dict[str, Change]:
    """Return every change of a received folder, by what it is; manifests fit what they hold."""
    numbers = ("episodes", "seed", "series")
    devices = ("/dev/zero", "/dev/random", "/dev/stdin", "/proc/kmsg", "/proc/self/pagemap")
    changes: dict[str, Change] = {
        f"identity.{name} is {value}": set_in("identity", name, value=value)
        for name in numbers
        for value in LARGE
    }
    for name in ("max_envs", "tile_envs"):
        changes |= {f"{name} is {value}": set_in(name, value=value) for value in (*LARGE, 0)}
    changes |= {f"a source is {name}": named(name) for name in devices}
    changes["one file by 40 names"] = many_files
    changes["a file of this folder is a device"] = set_in(
        "files", value={"/dev/zero": "0" * 64, "../../../dev/zero": "0" * 64}
    )
    rows = [["x", "0" * 64, None]] * 1_000_000
    changes["a million partners in the manifest"] = set_in("identity", "partners", value=rows)
    for name in (tables.EPISODES_FILE, tables.PARTNERS_FILE, tables.PROFILE_FILE):
        changes[f"{name} of three million rows"] = sealed(name, more_rows)
    kinds: dict[str, tuple[pl.DataType, Any]] = {
        "numbers": (pl.Float64(), 1.0),
        "nothing": (pl.Null(), None),
    }
    for name, (kind, value) in kinds.items():
        changes[f"episodes: 5 * 10^7 rows of {name}"] = sealed(
            tables.EPISODES_FILE, one_column(kind, value)
        )
    tricks = (many_columns, long_text, many_partners, far_episodes)
    changes |= {
        f"episodes: {trick.__name__}": sealed(tables.EPISODES_FILE, trick) for trick in tricks
    }
    for name in (tables.SUMMARY_FILE, tables.RUN_FILE):
        for trick in (deep, long_number, many_zeros, blank):
            changes[f"{name}: {trick.__name__}"] = sealed(name, trick)
    changes["summary.json: long_notes"] = sealed(tables.SUMMARY_FILE, long_notes)
    changes["a picture of 60,000 by 60,000"] = sealed(tables.MATRIX_FIGURE, wide_picture)
    for trick in (deep, long_number, blank):
        changes[f"manifest: {trick.__name__}"] = lambda folder, trick=trick: _write(
            folder / provenance.MANIFEST_FILE, trick
        )
    return changes


def _write(path: Path, trick: Callable[[bytes], bytes]) -> None:
    path.write_bytes(trick(path.read_bytes()))


def _parquet(table: pl.DataFrame) -> bytes:
    content = io.BytesIO()
    table.write_parquet(content, compression="zstd", compression_level=19, row_group_size=ROWS)
    return content.getvalue()
