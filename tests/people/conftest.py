"""Logs of recorded mouse paths, made once for all tests of a run."""

from pathlib import Path
from typing import Any

import pytest

from tests.people.maker import make_log
from zoo.registry import Registry, load_registry


@pytest.fixture(scope="session")
def registry() -> Registry:
    return load_registry(None)


@pytest.fixture(scope="session")
def with_robot(registry: Registry) -> dict[str, Any]:
    """A log with a robot that hears words."""
    return make_log("gentle_scratch", registry, robot=0, start=5, path=0)


@pytest.fixture(scope="session")
def with_script(registry: Registry) -> dict[str, Any]:
    """A log with the script."""
    return make_log("gentle_scratch", registry, robot="script", start=6, path=1)


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Where a log is written."""
    return tmp_path / "log.json"
