from pathlib import Path

import pytest

from assistax_zoo.shell.main import run
from tests.cli.test_zoo_commands import write_run


@pytest.fixture
def zoo(tmp_path: Path, monkeypatch, capsys) -> Path:
    """A published registry, named by the environment variable."""
    path = tmp_path / "zoo" / "registry.json"
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(path))
    folder = str(write_run(tmp_path / "run"))
    assert run(["publish", folder, "--release", "v0", "--date", "2027-01-31"]) == 0
    assert "published 16 new policies" in capsys.readouterr().out
    return path
