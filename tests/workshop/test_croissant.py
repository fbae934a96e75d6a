"""A remote's Croissant metadata names each of its files with the sha256 that it has."""

import json
from pathlib import Path

from assistax_base.digest import sha256
from assistax_workshop.press.croissant import FILE
from assistax_workshop.press.hub_publish import publish_to
from tests.zoo.conftest import trained_teams

TEXTS = {FILE, "README.md"}


def test_each_file_of_a_remote_has_its_hash_and_size(tmp_path: Path) -> None:
    place = tmp_path / "zoo"
    publish_to(trained_teams(), str(place), "v0", license="mit")
    content = json.loads((place / FILE).read_text())
    assert content["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    assert content["license"] == "https://spdx.org/licenses/mit"
    assert content["name"] == "zoo" and content["version"] == "0.0.0"
    named = {file["contentUrl"]: file for file in content["distribution"]}
    there = {path for path in place.rglob("[!.]*") if path.is_file() and path.name not in TEXTS}
    assert named.keys() == {path.relative_to(place).as_posix() for path in there}
    for path, file in named.items():
        data = (place / path).read_bytes()
        assert (file["sha256"], file["contentSize"]) == (sha256(data), f"{len(data)} B")
    publish_to(trained_teams(("mappo",)), str(place), "v0")
    again = json.loads((place / FILE).read_text())
    assert len(again["distribution"]) > len(named) and again["license"] == content["license"]
