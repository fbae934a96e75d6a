"""A zoo of four untrained teams, a training run and an evaluation, made once for all attacks."""

import shutil
from pathlib import Path

import pytest

from tests.attack.commands import Command, commands, small_zoo
from tests.attack.process import call
from tests.attack.readers import make_results


@pytest.fixture(scope="session")
def registry_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_zoo(tmp_path_factory.mktemp("zoo"))


@pytest.fixture(scope="session")
def made(registry_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the training run `run` and the evaluation `result`."""
    home = tmp_path_factory.mktemp("made")
    table = commands(registry_path, home / "run", home / "result")
    for name, target in (("train", "run"), ("evaluate", "result")):
        done = call(table[name].words, home / name)
        assert done.code == 0, done.err
        shutil.move(home / name / "out", home / target)
    return home


@pytest.fixture(scope="session")
def results(registry_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two evaluations, `a` and `b`, and the cross-play `xp`."""
    return make_results(registry_path, tmp_path_factory.mktemp("results"))


@pytest.fixture(scope="session")
def table(made: Path, registry_path: Path) -> dict[str, Command]:
    """The commands under attack, on what was made."""
    return commands(registry_path, made / "run", made / "result")
