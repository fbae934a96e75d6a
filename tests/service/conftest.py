"""A real PostgreSQL, where Debian's `postgresql` is installed."""

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
import sqlalchemy as sa


@pytest.fixture(scope="session")
def postgres() -> Iterator[sa.URL]:
    """Run a cluster on a socket of its own, as nobody's superuser: it refuses to be root."""
    binaries = _binaries()
    if binaries is None:
        tell = pytest.fail if os.environ.get("REQUIRE_SYSTEM") == "1" else pytest.skip
        tell("needs postgresql (Debian: apt-get install postgresql)")
    # Not in pytest's own folder, which only root may enter; and a socket's path has to be short.
    folder = Path(tempfile.mkdtemp(prefix="zoo-postgres-"))
    user = "postgres" if os.getuid() == 0 else None
    if user:
        shutil.chown(folder, user)
    options = f"-k {folder} -c listen_addresses='' -c fsync=off"
    data = str(folder / "data")
    run: dict[str, Any] = {"check": True, "user": user, "capture_output": True, "cwd": folder}
    subprocess.run([binaries / "initdb", "-D", data, "-A", "trust", "-U", "zoo"], **run)
    control = [binaries / "pg_ctl", "-D", data, "-w"]
    # Its own output goes to a file: the server would keep a pipe open for ever.
    log = str(folder / "log")
    start: list[Any] = [*control, "-o", options, "-l", log, "start"]
    subprocess.run(start, check=True, user=user, cwd=folder, stdout=subprocess.DEVNULL)
    try:
        yield sa.make_url(f"postgresql+psycopg://zoo@/postgres?host={folder}")
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], **run)
        shutil.rmtree(folder)


@pytest.fixture
def postgres_url(postgres: sa.URL) -> Iterator[str]:
    """Make a database for one test."""
    name = f"t{uuid4().hex}"
    engine = sa.create_engine(postgres, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(sa.text(f"CREATE DATABASE {name}"))
    yield postgres.set(database=name).render_as_string(hide_password=False)
    with engine.connect() as connection:
        connection.execute(sa.text(f"DROP DATABASE {name} WITH (FORCE)"))
    engine.dispose()


def _binaries() -> Path | None:
    found = [Path(each) for each in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)]
    with contextlib.suppress(TypeError):
        found.append(Path(str(shutil.which("initdb"))).parent)
    return next((each for each in found if (each / "initdb").is_file()), None)
