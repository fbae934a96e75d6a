"""CI holds the registry against its earlier states: growth passes, a rewriting does not."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.zoo.conftest import put, trained_teams
from tools.grown import check, main
from zoo.schema import RegistryFile


def commit(folder: Path) -> None:
    for words in (["add", "-A"], ["commit", "-qm", "a state"]):
        who = ["-c", "user.name=test", "-c", "user.email=test@localhost"]
        subprocess.run(["git", *who, *words], cwd=folder, check=True)


def version(folder: Path, of: str) -> None:
    (folder / "pyproject.toml").write_text(f'[project]\nversion = "{of}"\n')


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository whose registry grew once."""
    folder = tmp_path / "repository"
    folder.mkdir()
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    version(folder, "1.0.0")
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
    assert (
        "no earlier registry.json of version 1.0 or later in this clone" in capsys.readouterr().out
    )


def test_states_before_version_1_do_not_count(repository: Path, capsys) -> None:
    version(repository, "0.9.3")
    (repository / "registry.json").unlink()
    shutil.rmtree(repository / "zoo")
    put(trained_teams(seeds=range(3)), repository / "registry.json")
    commit(repository)
    version(repository, "1.0.0")
    commit(repository)
    assert main(repository) == 1  # the fixture's states are of 1.0
    subprocess.run(["git", "checkout", "-q", "--orphan", "anew"], cwd=repository, check=True)
    version(repository, "0.9.3")
    commit(repository)
    (repository / "registry.json").unlink()
    put(trained_teams(), repository / "registry.json")
    version(repository, "1.0.0")
    commit(repository)
    capsys.readouterr()
    assert main(repository) == 0
    assert "no earlier registry.json of version 1.0" in capsys.readouterr().out


@pytest.fixture
def releases(tmp_path: Path) -> RegistryFile:
    """A registry of the releases v0 and v1."""
    path = tmp_path / "releases" / "registry.json"
    put(trained_teams(), path)
    return put(trained_teams(), path, "v1").data


def without(data: RegistryFile, release: str) -> RegistryFile:
    """Return the registry without a release."""
    fields = {
        "release": next(name for name in data.releases if name != release),
        "teams": {name: team for name, team in data.teams.items() if not name.endswith(release)},
        "splits": tuple(split for split in data.splits if split.release != release),
        "releases": {n: entry for n, entry in data.releases.items() if n != release},
    }
    return data.model_copy(update=fields)


def test_no_release_may_be_missing(releases: RegistryFile) -> None:
    [problem] = check(without(releases, "v1"), {"commit": releases})
    assert "version 1 of scratch in v1" in problem


def test_no_byte_of_a_release_may_change(releases: RegistryFile) -> None:
    name = "scratch/ippo-d1-s0-v1"
    team = releases.teams[name]
    place = team.policies["robot"]
    digest = ("0" if place.sha256[0] != "0" else "1") + place.sha256[1:]
    policies = {**team.policies, "robot": place.model_copy(update={"sha256": digest})}
    changed = {**releases.teams, name: team.model_copy(update={"policies": policies})}
    new = releases.model_copy(update={"teams": changed})
    [problem] = check(new, {"commit": releases})
    assert f"team {name}" in problem
