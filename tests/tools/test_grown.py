"""CI holds the registry against its earlier states: growth passes, a rewriting does not."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.zoo.conftest import put, trained_teams
from tools.grown import REWRITTEN, WITHDRAWN, check, earlier_states, main, parse_state
from zoo.registry import load_registry
from zoo.schema import RegistryFile

ROOT = Path(__file__).parents[2]


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
    published = json.loads((ROOT / "registry.json").read_text())
    assert REWRITTEN.isdisjoint(release["root"] for release in published["releases"].values())


@pytest.fixture
def releases(tmp_path: Path) -> RegistryFile:
    """A registry of the releases v0 and v1."""
    path = tmp_path / "releases" / "registry.json"
    put(trained_teams(), path)
    return put(trained_teams(), path, "v1").data


def without(data: RegistryFile, release: str, record: bool = True) -> RegistryFile:
    """Return the registry without a release's teams and splits, or with its record alone."""
    fields = {
        "release": next(name for name in data.releases if name != release),
        "teams": {name: team for name, team in data.teams.items() if not name.endswith(release)},
        "splits": tuple(split for split in data.splits if split.release != release),
    }
    if record:
        fields["releases"] = {n: entry for n, entry in data.releases.items() if n != release}
    return data.model_copy(update=fields)


def test_a_withdrawn_release_may_be_missing(releases: RegistryFile) -> None:
    assert check(without(releases, "v0"), {"commit": releases}) == []


def test_a_withdrawn_release_is_missing_whole(releases: RegistryFile) -> None:
    [problem] = check(without(releases, "v0", record=False), {"commit": releases})
    assert "run scratch-ippo" in problem and "gone or changed" in problem


def test_another_release_may_not_be_missing(releases: RegistryFile) -> None:
    [problem] = check(without(releases, "v1"), {"commit": releases})
    assert "version 1 of scratch in v1" in problem


def test_a_byte_of_another_release_may_not_change(releases: RegistryFile) -> None:
    name = "scratch/ippo-d1-s0-v1"
    team = releases.teams[name]
    place = team.policies["robot"]
    digest = ("0" if place.sha256[0] != "0" else "1") + place.sha256[1:]
    policies = {**team.policies, "robot": place.model_copy(update={"sha256": digest})}
    changed = {**releases.teams, name: team.model_copy(update={"policies": policies})}
    new = without(releases.model_copy(update={"teams": changed}), "v0")
    [problem] = check(new, {"commit": releases})
    assert f"team {name}" in problem


def test_the_page_names_each_withdrawn_releases_commit() -> None:
    page = (ROOT / "docs" / "stability.md").read_text()
    registry = load_registry(ROOT / "registry.json").data
    assert WITHDRAWN.keys().isdisjoint(registry.releases)
    assert all(f"`{name}`" in page and commit in page for name, commit in WITHDRAWN.items())
