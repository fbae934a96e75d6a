import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from assistax_base.files import atomic_path, atomic_write


def test_failed_write_leaves_only_the_old_file(tmp_path: Path) -> None:
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
        "from assistax_base.files import atomic_path\n"
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


def test_a_disk_that_is_full_names_the_file(tmp_path: Path) -> None:
    code = (
        "import resource, sys; from pathlib import Path\n"
        "from assistax_base.files import atomic_write\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (8, 8))\n"
        "atomic_write(Path(sys.argv[1]), b'more than eight bytes')"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "figures.json")]
    done = subprocess.run(words, timeout=60, capture_output=True, text=True)
    assert done.stderr.strip().endswith(f"File too large: '{tmp_path / 'figures.json'}'")
    assert list(tmp_path.iterdir()) == []


def test_a_device_is_not_replaced() -> None:
    with pytest.raises(OSError, match="not a regular file"):
        atomic_write(Path(os.devnull), b"")
    assert not Path(os.devnull).is_file()


class Disk:
    """Records what is flushed and renamed, and what a power cut before any of it would leave."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.flushed: dict[str, bytes | None] = {}  # what is on the disk for sure, by path
        self.unsafe: list[str] = []  # renamed to their place before their bytes were on the disk
        self._fsync, self._replace = os.fsync, os.replace
        monkeypatch.setattr(os, "fsync", self.fsync)
        monkeypatch.setattr(os, "replace", self.replace)

    def fsync(self, descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        self.flushed[str(path)] = path.read_bytes() if path.is_file() else None
        self._fsync(descriptor)

    def replace(self, source: Path, target: Path) -> None:
        if self.flushed.pop(str(source), None) != Path(source).read_bytes():
            self.unsafe.append(str(target))
        self.flushed.pop(str(Path(target).parent), None)  # its entry is not there yet
        self._replace(source, target)


def test_a_file_is_on_the_disk_before_it_has_its_name_and_the_name_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a power cut leaves an empty file in the place of the old one."""
    disk = Disk(monkeypatch)
    atomic_write(tmp_path / "a", b"whole")
    assert disk.unsafe == [] and str(tmp_path) in disk.flushed
    monkeypatch.setattr("assistax_base.files._flush", lambda path: None)  # a planted defect
    atomic_write(tmp_path / "a", b"more")
    assert disk.unsafe == [str(tmp_path / "a")] and str(tmp_path) not in disk.flushed
