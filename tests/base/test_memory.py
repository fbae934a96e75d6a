"""Too little memory is no fault of a file: it is told as such, and the file stays."""

import errno
import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from assistax_base import bounded_reading, parquet
from assistax_base.errors import RegistryError, lacks_memory

ROOT = Path(__file__).parents[2]
# Given a limit in megabytes beside what the process has, a function and a file; prints the error.
LIMITED = """
import resource, sys
from pathlib import Path
from assistax_base import parquet
taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
room = taken + int(sys.argv[1]) * 1_000_000
resource.setrlimit(resource.RLIMIT_AS, (room, room))
path = Path(sys.argv[3])
try:
    getattr(parquet, sys.argv[2])([path] if sys.argv[2] == "check_readable" else path)
except BaseException as error:
    print(type(error).__name__, error)
"""


@pytest.mark.parametrize(
    ("error", "lacks"),
    [
        (MemoryError(), True),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), True),
        (pl.exceptions.ComputeError("Cannot allocate memory (os error 12)"), True),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate"), True),
        (OSError(errno.ENOSPC, "No space left on device"), False),
        (pl.exceptions.ComputeError("parquet: File out of specification"), False),
    ],
)
def test_errors_that_lack_memory_are_known(error: BaseException, lacks: bool) -> None:
    assert lacks_memory(error) is lacks


@pytest.mark.slow
@pytest.mark.parametrize("function", ["read_parquet", "check_readable"])
def test_a_whole_table_is_not_called_damaged(function: str, tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    values = np.random.default_rng(0).normal(size=20_000_000)
    pl.DataFrame({"return": values}).write_parquet(path)
    words = [sys.executable, "-c", LIMITED, "60", function, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert done.stdout == f"MemoryError {path} was not read, and may be whole\n", done.stderr[-300:]
    assert path.is_file()


def test_memory_error_of_text_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> io.BytesIO:
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    (path := tmp_path / "registry.json").write_text("{}")
    monkeypatch.setattr(Path, "open", fail)
    with pytest.raises(MemoryError, match="may be whole"):
        bounded_reading.read_text(path, 100, RegistryError, "registry", "restore it")


def test_a_damaged_table_is_still_damaged(tmp_path: Path) -> None:
    (path := tmp_path / "table.parquet").write_bytes(b"PAR1" + bytes(100) + b"PAR1")
    with pytest.raises(ValueError, match="another process could not read it"):
        parquet.check_readable([path])
    with pytest.raises(ValueError, match="not a readable Parquet file"):
        parquet.read_parquet(path)
