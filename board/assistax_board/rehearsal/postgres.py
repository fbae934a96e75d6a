"""A PostgreSQL of one's own, for a rehearsal and for tests: started, killed, started again."""

import contextlib
import importlib.util
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import sqlalchemy as sa

START_SECONDS = 60.0


class Cluster:
    """A cluster on a socket of its own, under a user without rights: it refuses to be root."""

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
        """Start it, also where the processes of a killed one have not all gone yet.

        Raises:
            ValueError: It does not start within a minute.
        """
        options = f"-k {self._folder} -c listen_addresses='' -c fsync=off"
        # Its own output goes to a file: the server would keep a pipe open for ever.
        words = [*self._control, "-o", options, "-l", str(self._folder / "log"), "start"]
        end = time.monotonic() + START_SECONDS
        while self._run(words).returncode != 0:
            if time.monotonic() > end:
                log = (self._folder / "log").read_text()
                raise ValueError(f"PostgreSQL does not start: {log[-2000:]}")
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
def cluster(binaries: Path) -> Generator[Cluster]:
    """Run a new cluster while the block runs."""
    # Its user must be able to enter the folder, and a socket's path has to be short.
    folder = Path(tempfile.mkdtemp(prefix="zoo-postgres-"))
    running = None
    try:
        running = Cluster(binaries, folder)
        yield running
    finally:
        if running is not None:
            running.stop()
        shutil.rmtree(folder)


def find_binaries() -> Path | None:
    """Return the folder of PostgreSQL's programs; None if it is not installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    if path := shutil.which("initdb"):
        found.append(Path(path).resolve().parent)
    return next((folder for folder in found if (folder / "initdb").is_file()), None)


def missing() -> str | None:
    """Return in words the parts of a cluster that are missing here; None if all are here."""
    if find_binaries() is None:
        return "PostgreSQL is not installed"
    if importlib.util.find_spec("psycopg") is None:
        return "the package psycopg is not installed (pip install 'assistax-zoo-board[postgres]')"
    if os.getuid() == 0:
        try:
            pwd.getpwnam("postgres")
        except KeyError:
            return "there is no user postgres, and PostgreSQL does not run as root"
    return None
