"""A PostgreSQL of the tests, where one is installed."""

import contextlib
import os
from collections.abc import Generator

import pytest

from assistax_board.rehearsal import postgres
from assistax_board.rehearsal.postgres import Cluster


@contextlib.contextmanager
def cluster() -> Generator[Cluster]:
    """Lend a cluster; skip the test where PostgreSQL is not installed."""
    binaries = postgres.find_binaries()
    if binaries is None:
        tell = pytest.fail if os.environ.get("REQUIRE_SYSTEM") == "1" else pytest.skip
        tell("needs postgresql (Debian: apt-get install postgresql)")
    with postgres.cluster(binaries) as running:
        yield running
