import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from population.files import atomic_path, atomic_write


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "figures.json"
    atomic_write(target, b"old")
    with pytest.raises(RuntimeError, match="half"), atomic_path(target) as temporary:
        temporary.write_bytes(b"ne")
        raise RuntimeError("half")
    assert target.read_bytes() == b"old"
    assert [file.name for file in target.parent.iterdir()] == ["figures.json"]


def test_what_a_killed_writer_left_is_removed_once_it_is_old(tmp_path: Path) -> None:
    target = tmp_path / "a[1].bin"
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from population.files import atomic_path\n"
        "with atomic_path(Path(sys.argv[1])) as temporary:\n"
        "    temporary.write_bytes(b'half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(target)], timeout=60)
    assert done.returncode == -signal.SIGKILL
    [left] = tmp_path.iterdir()
    atomic_write(target, b"whole")
    assert left.exists()  # young: it may be another process's
    os.utime(left, (0, 0))
    atomic_write(target, b"whole")
    assert list(tmp_path.iterdir()) == [target] and target.read_bytes() == b"whole"


def test_a_device_is_not_replaced() -> None:
    with pytest.raises(OSError, match="no regular file"):
        atomic_write(Path(os.devnull), b"")
    assert not Path(os.devnull).is_file()
