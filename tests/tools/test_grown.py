"""CI holds the registry against its earlier states: growth passes, a rewriting does not."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.zoo.conftest import put, trained_teams
from tools.grown import REWRITTEN, check, earlier_states, main, parse_state
from zoo.registry import load_registry


def commit(folder: Path) -> None:
    for words in (["add", "-A"], ["commit", "-qm", "a state"]):
        who = ["-c", "user.name=test", "-c", "user.email=test@localhost"]
        subprocess.run(["git", *who, *words], cwd=folder, check=True)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository whose registry grew once."""
    folder = tmp_path / "repository"
    folder.mkdir()
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    put(trained_teams(), folder / "registry.json")
    commit(folder)
    put(trained_teams(("mappo",)), folder / "registry.json")
    commit(folder)
    return folder


def test_a_registry_that_grew_passes(repository: Path, capsys) -> None:
    assert main(repository) == 0
    assert "against 1 earlier states: 0 problems" in capsys.readouterr().out
    (repository / "other").write_text("another commit, which leaves the registry")
    commit(repository)
    assert main(repository) == 0
    assert "against 2 earlier states: 0 problems" in capsys.readouterr().out


def test_a_rewriting_is_found_even_some_commits_later(repository: Path, capsys) -> None:
    (repository / "registry.json").unlink()
    shutil.rmtree(repository / "zoo")
    put(trained_teams(seeds=range(3)), repository / "registry.json")
    commit(repository)
    assert main(repository) == 1
    assert "scratch/ippo-d1-s3-v0" in capsys.readouterr().out
    (repository / "other").write_text("another commit")
    commit(repository)
    assert main(repository) == 1


def test_a_clone_without_a_past_says_so(repository: Path, tmp_path: Path, capsys) -> None:
    words = ["git", "clone", "-q", "--depth", "1", f"file://{repository}", str(tmp_path / "clone")]
    subprocess.run(words, check=True)
    assert main(tmp_path / "clone") == 0
    assert "no earlier registry.json in this clone" in capsys.readouterr().out


def test_a_state_of_the_first_schema_is_read(repository: Path) -> None:
    path = repository / "registry.json"
    old = json.loads(path.read_text())
    for release in old["releases"].values():
        del release["root"]
    for team in old["teams"].values():
        team["self_play"]["ci"] = team["self_play"].pop("mean_ci")
    text = json.dumps(old | {"schema_version": 1})
    assert parse_state(text, "an earlier state") == load_registry(path).data


def test_one_rewriting_is_known_and_no_other(repository: Path) -> None:
    [old] = earlier_states(repository).values()
    new = load_registry(repository / "registry.json").data
    empty = new.model_copy(update={"teams": {}})
    assert len(check(empty, {"commit": old})) == 1
    record = old.releases["v0"].model_copy(update={"root": min(REWRITTEN)})
    known = old.model_copy(update={"releases": {"v0": record}})
    assert check(empty, {"commit": known}) == []
    published = json.loads((Path(__file__).parents[2] / "registry.json").read_text())
    assert REWRITTEN.isdisjoint(release["root"] for release in published["releases"].values())
