"""`cite` names what was used, and agrees with CITATION.cff."""

import json
import re
import tomllib
from pathlib import Path

import pytest
import yaml

from assistax_base.digest import sha256
from assistax_zoo.commands.partners.cite import DOI
from assistax_zoo.shell.main import run
from tests.cli.test_zoo_commands import write_run
from tests.zoo.conftest import put, trained_teams
from zoo.registry import load_registry
from zoo.verify import verify

ROOT = Path(__file__).parents[2]


def cited(capsys, *words: str) -> dict[str, dict[str, str]]:
    """Return the fields of each entry."""
    assert run(["cite", *words]) == 0
    text = capsys.readouterr().out
    assert text.count("{") == text.count("}")
    entries = re.split(r"\n\n(?=@)", text.strip())
    citations = {}
    for entry in entries:
        key = re.match(r"@\w+\{(\w+),\n", entry)
        assert key is not None and entry.endswith("}\n}")
        fields = re.findall(r"^  (\w+) = \{((?:.|\n)*?)\}(?:,|\n\})", entry, re.MULTILINE)
        citations[key[1]] = {name: " ".join(value.split()) for name, value in fields}
    return citations


def test_citation_agrees_with_the_citation_file(capsys) -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    citations = cited(capsys)
    [paper] = citation["references"]
    printed = citations["hinckeldey2025assistax"]
    names = [f"{author['family-names']}, {author['given-names']}" for author in paper["authors"]]
    assert printed["author"].split(" and ") == names
    assert (printed["title"], printed["url"]) == (paper["title"], paper["url"])
    assert printed["year"] == str(paper["year"])
    assert citations["assistax_zoo"]["title"] == citation["title"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])


def test_citation_names_release_root_and_registry(capsys) -> None:
    registry = load_registry()
    note = cited(capsys, "--release", "v1")["assistax_zoo_v1"]["note"]
    assert f"root {registry.root('v1')}" in note
    assert f"registry {sha256(registry.path.read_bytes())}" in note
    assert all(split in note for split in registry.data.releases["v1"].splits.values())


def test_a_lock_and_another_release_are_refused(tmp_path: Path, capsys) -> None:
    path = tmp_path / "registry.json"
    put(trained_teams(), path)
    put(trained_teams(), path, "v1")
    own, lock = ["--registry", str(path)], str(tmp_path / "paper.lock")
    assert run(["lock", "--release", "v1", "--out", lock, *own]) == 0
    capsys.readouterr()
    assert run(["cite", "--lock", lock, "--release", "v0", *own]) == 1
    assert "pins release v1, not v0" in capsys.readouterr().err


def test_citation_names_the_pins_of_a_lock(tmp_path: Path, capsys) -> None:
    lock = tmp_path / "paper.lock"
    assert run(["lock", "--task", "scratch", "--release", "v1", "--out", str(lock)]) == 0
    capsys.readouterr()
    note = cited(capsys, "--lock", str(lock))["assistax_zoo_v1"]["note"]
    assert f"lock {json.loads(lock.read_text())['sha256']}" in note
    assert "scratch/half-s0-v1-524fe016" in note and "bed_bath/" not in note
    assert run(["cite", "--release", "v9"]) == 1
    assert "v9" in capsys.readouterr().err


def test_foreign_zoo_is_cited_by_its_wish(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setenv("ASSISTAX_ZOO_DATA", str(tmp_path / "data"))
    lab, folder = tmp_path / "lab", str(write_run(tmp_path / "run"))
    words = ["publish", folder, "--release", "v0", "--to", str(lab)]
    assert run(words) == 0 and run(["add", str(lab), "--as", "lab"]) == 0
    capsys.readouterr()
    assert run(["cite", "--release", "lab:v0", "--json"]) == 0
    unnamed = json.loads(capsys.readouterr().out)["partners"]
    assert "names no authors" in unnamed and "author =" not in unnamed
    names = ["--author", "Curie, Marie", "--author", "Noether, {Emmy}"]
    names += ["--title", "Partners & More", "--url", "https://lab.example/zoo"]
    assert run([*words, *names]) == 0 and run([*words, *names]) == 0
    assert verify(load_registry(lab / "registry.json")).ok
    assert run(["add", str(lab), "--as", "lab", "--yes"]) == 0
    capsys.readouterr()
    entry = cited(capsys, "--release", "lab:v0")["assistax_zoo_lab_v0"]
    assert entry["author"] == "Curie, Marie and Noether, Emmy"
    assert (entry["title"], entry["url"]) == (r"Partners \& More", "https://lab.example/zoo")
    registry = load_registry(lab / "registry.json")
    assert f"root {registry.root('v0')}" in entry["note"]
    assert f"registry {sha256(registry.path.read_bytes())}" in entry["note"]
    assert run([*words, "--url", "lab.example/{zoo}"]) == 1
    assert "citation" in capsys.readouterr().err


def test_a_result_is_cited_by_what_it_used(tmp_path: Path, capsys) -> None:
    team, out = "scratch/ippo-d1-s0", str(tmp_path / "out")
    play = ["--episodes", "1", "--backend", "native", "--no-references", "--split", "both"]
    robots = ["evaluate", "scratch/ppo-ego-s0", "--partners", "scratch/ippo-d1-s[01]"]
    assert run([*robots, *play, "--out", out]) == 0
    capsys.readouterr()
    registry = load_registry()
    note = cited(capsys, out)["assistax_zoo_v1"]["note"]
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert f"root {registry.root('v1')}; scratch in version 1; split scratch/half" in note
    assert f"result {manifest['sha256']}" in note and team not in note
    assert run(["cite", out, "--release", "v1"]) == 1
    assert "says what was used" in capsys.readouterr().err
    path = tmp_path / "registry.json"
    put(trained_teams(), path, "v1")
    assert run(["cite", out, "--registry", str(path)]) == 1
    assert "which the registry in use does not have" in capsys.readouterr().err


def test_software_has_a_doi_once_there_is_one(capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation.get("doi", "") == DOI
    monkeypatch.setattr("assistax_zoo.commands.partners.cite.DOI", "10.5281/zenodo.1")
    assert cited(capsys)["assistax_zoo"]["doi"] == "10.5281/zenodo.1"
