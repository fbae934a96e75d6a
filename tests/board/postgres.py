"""A PostgreSQL of the tests: started, killed, started again."""

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa


class Cluster:
    """A cluster on a socket of its own, as nobody's superuser: it refuses to be root."""

    def __init__(self, binaries: Path, folder: Path) -> None:
        self.url = sa.make_url(f"postgresql+psycopg://zoo@/postgres?host={folder}")
        self._folder, self._data = folder, folder / "data"
        self._user = "postgres" if os.getuid() == 0 else None
        if self._user:
            shutil.chown(folder, self._user)
        self._control = [binaries / "pg_ctl", "-D", str(self._data), "-w"]
        initdb = [binaries / "initdb", "-D", str(self._data), "-A", "trust", "-U", "zoo"]
        self._run(initdb, check=True)
        self.start()

    def start(self) -> None:
        """Start it, also where the processes of a killed one have not all gone yet."""
        options = f"-k {self._folder} -c listen_addresses='' -c fsync=off"
        # Its own output goes to a file: the server would keep a pipe open for ever.
        words = [*self._control, "-o", options, "-l", str(self._folder / "log"), "start"]
        end = time.monotonic() + 60
        while self._run(words).returncode != 0:
            assert time.monotonic() < end, (self._folder / "log").read_text()[-2000:]
            time.sleep(0.2)

    def kill(self) -> None:
        """Kill the postmaster; its children see that and leave without a word."""
        pid = int((self._data / "postmaster.pid").read_text().split()[0])
        os.kill(pid, signal.SIGKILL)

    def stop(self) -> None:
        """Stop it, if it runs."""
        self._run([*self._control, "-m", "immediate", "stop"])

    def _run(self, words: list[Any], *, check: bool = False) -> Any:
        options: dict[str, Any] = {"user": self._user, "cwd": self._folder, "check": check}
        return subprocess.run(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **options
        )


@contextlib.contextmanager
def cluster() -> Generator[Cluster]:
    """Lend a cluster; skip the test where PostgreSQL is not installed."""
    binaries = _binaries()
    if binaries is None:
        tell = pytest.fail if os.environ.get("REQUIRE_SYSTEM") == "1" else pytest.skip
        tell("needs postgresql (Debian: apt-get install postgresql)")
    # Not in pytest's own folder, which only root may enter; and a socket's path has to be short.
    folder = Path(tempfile.mkdtemp(prefix="zoo-postgres-"))
    running = Cluster(binaries, folder)
    try:
        yield running
    finally:
        running.stop()
        shutil.rmtree(folder)


def _binaries() -> Path | None:
    folders = [
        Path(path) for path in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    ]
    with contextlib.suppress(TypeError):
        folders.append(Path(str(shutil.which("initdb"))).parent)
    return next((folder for folder in folders if (folder / "initdb").is_file()), None)
