"""Reading and writing of Parquet files. A path is never a pattern, a home or an address.

Anybody may have damaged a file: it is read, or refused in one line.
"""

import io
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.errors import lacks_memory
from assistax_base.files import atomic_path

# Of a process that only reads: what Polars has taken by then, and this much beside.
_ROOM = 1 << 30
_TRY = """
import io, resource, sys
import polars
try:
    pages = int(open("/proc/self/statm").read().split()[0])
    room = pages * resource.getpagesize() + int(sys.argv[1])
    allowed = min(limit % (1 << 64) for limit in resource.getrlimit(resource.RLIMIT_AS))
    if room <= allowed:
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
        print("enough", flush=True)
except OSError:
    print("enough", flush=True)
for path in sys.argv[2:]:
    polars.read_parquet(io.BytesIO(open(path, "rb").read()))
    print("read", flush=True)
"""
_ENDED_FOR_MEMORY = -9  # as Linux ends processes when it has no memory left
_UNREADABLE = (pl.Int128, pl.UInt128)  # NumPy has no such numbers
_readable: set[tuple[str, int, int]] = set()  # paths, sizes and times of files that were read


def read_parquet(path: Path) -> pl.DataFrame:
    """Return a table.

    Polars would take "run[1]" for a pattern, which another folder matches, and a relative path that
    begins with "~" for a home: the path is made absolute, and read as it is spelled.

    Raises:
        ValueError: The file is damaged, no Parquet, or has a column type that nothing of ours has.
        MemoryError: There is not enough memory.
    """
    try:
        table = pl.read_parquet(_source(path), glob=False)
    except BaseException as error:
        # Polars' reader can panic on damaged bytes: a BaseException, which no handler expects.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        if lacks_memory(error):
            raise _too_little(path) from None
        raise _damaged(path, (str(error).splitlines() or [type(error).__name__])[0]) from None
    for name, dtype in table.schema.items():
        if dtype in _UNREADABLE:
            raise ValueError(
                f"{path}: column {name!a} is {dtype}; integers of at most 64 bits are allowed; "
                "take the file from where it was made"
            )
    return table


def read_metadata(path: Path) -> dict[str, str]:
    """Return the metadata of a Parquet file by key. Call `check_readable` before."""
    return pl.read_parquet_metadata(_source(path))


def write_parquet(table: pl.DataFrame, path: Path, **options: Any) -> None:
    """Write a table, whole or not at all; `options` are those of Polars' method of this name."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        table.write_parquet(file, **options)


def check_readable(paths: Sequence[Path]) -> None:
    """Let another process read files first, if a stranger or time may have changed them.

    A page says how many values it holds, and Polars asks for the memory of as many. Where there is
    not so much, Rust aborts: no handler is asked, and the whole process is gone.

    Raises:
        ValueError: A file is damaged, or no Parquet.
        MemoryError: There is not enough memory for another process, or for what it may take.
    """
    unread = [path for path in paths if path.is_file() and _state(path) not in _readable]
    if not unread:
        return
    room = _ROOM + 30 * sum(path.stat().st_size for path in unread)
    names = [str(path.absolute()) for path in unread]
    command = [sys.executable, "-P", "-c", _TRY, str(room), *names]
    # Each thread reserves addresses, which on a machine of many cores are more than the limit.
    environment = os.environ | {"POLARS_MAX_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
    done = subprocess.run(command, capture_output=True, check=False, env=environment)
    lines = done.stdout.splitlines()
    read = lines.count(b"read")
    if read < len(unread):
        if b"enough" not in lines or done.returncode == _ENDED_FOR_MEMORY:
            raise _too_little(unread[read])
        raise _damaged(unread[read], "another process could not read it")
    _readable.update(map(_state, unread))


# Of a table: so many values, and so many more for each byte of its file; ours have ten at most.
_VALUES, _VALUES_PER_BYTE = 20_000_000, 100


def check_size(path: Path) -> None:
    """Refuse a file that claims far more rows than its size allows.

    A run of one value is some kilobytes as a file, and gigabytes as a table.

    Raises:
        ValueError: It is one.
    """
    try:
        rows = pl.scan_parquet(_source(path), glob=False).select(pl.len()).collect().item()
        columns, size = len(pl.read_parquet_schema(_source(path))), path.stat().st_size
    except BaseException as error:
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        return  # whoever reads it says what is wrong
    if rows * columns > _VALUES + _VALUES_PER_BYTE * size:
        raise _damaged(path, f"{rows} rows of {columns} columns in {size} bytes")


def _source(path: Path) -> Path | io.BytesIO:
    """Return the source that Polars reads: the file's absolute path, or its bytes.

    Polars takes no path that is not UTF-8.
    """
    try:
        str(path).encode()
        return path.absolute()
    except UnicodeEncodeError:
        return io.BytesIO(path.read_bytes())


def _state(path: Path) -> tuple[str, int, int]:
    status = path.stat()
    return str(path.resolve()), status.st_size, status.st_mtime_ns


def _too_little(path: Path) -> MemoryError:
    return MemoryError(f"{path} was not read, and may be whole")


def _damaged(path: Path, reason: str) -> ValueError:
    return ValueError(f"{path} is not a readable Parquet file ({reason}); delete it and run again")
