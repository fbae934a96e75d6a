"""Published hashes stay what they are, and one module makes them."""

from pathlib import Path

import numpy as np
import pytest

from assistax_base.digest import canonical_json, json_sha256, leaf_sha256, merkle_root
from population.networks.spec import PolicySpec
from zoo.history.merkle import release_root
from zoo.parameters.storage import policy_bytes, read_policy_file
from zoo.registry import load_registry

ROOT = Path(__file__).parents[2]
VALUE = {"b": [1, 2.5, None], "a": "é", "c": {"z": True, "y": 1e-7}}


def test_hashes_of_json_are_those_that_were_published() -> None:
    compact = "a007231ca31650df8d80207e99ae98644efd5d029e7b56a8d26945e73d542649"
    spaced = "b1cb41f7610246aaf1f671a0dddc4e3547eaadae4b9067b239056e1a43cf315c"
    assert json_sha256(VALUE) == compact and json_sha256(VALUE, spaced=True) == spaced
    assert canonical_json({"b": 1, "a": "é"}) == b'{"a":"\\u00e9","b":1}'
    with pytest.raises(ValueError, match="JSON"):
        canonical_json(float("nan"))


@pytest.mark.parametrize(
    ("count", "root"),
    [
        (1, "81b6566fa48df5d9c9ac9ec3315cc585e8b593b6c60877affdfaaa430ef08125"),
        (2, "4ff4fc17cd2b1d73b332773c57e0535510d8329e5ab4e11d5c5b1fb1cb3123c4"),
        (3, "d60f692ab8504e02417ccdc016543c7e32726e40547e558313f7e5750c7075eb"),
        (5, "1e4518c6f150a44cd04e6d0bdd3285929a2a71860908314e8f1e37cc710e255f"),
        (8, "c6c78e69b4ac0189ce96796d8c5e74c8415e8bbe8ae07ec5f1c8156db4c85ce3"),
    ],
)
def test_roots_of_trees_are_those_that_were_published(count: int, root: str) -> None:
    assert merkle_root([leaf_sha256(VALUE)] * count) == root
    with pytest.raises(ValueError, match="at least one leaf"):
        merkle_root([])


def test_the_releases_of_the_project_have_their_roots() -> None:
    data = load_registry(ROOT / "registry.json").data
    root = "909ab9706202d269eb524469191efcdbf95edd452794938151bcec4fba81c6cc"
    assert release_root(data, "v1") == root


def test_specs_and_policy_files_have_their_hashes(tmp_path: Path) -> None:
    spec = PolicySpec(role="human", observation_size=20, action_size=3)
    assert spec.digest == "2e905007"
    data = policy_bytes(spec, {"a": np.arange(3, dtype=np.float32)}, {"id": "x"})
    assert b"6017ee40d9a3dfd17224f9cb13dc8cf40723a0b8589f6b714f4a69431a44fb34" in data
    (tmp_path / "policy.safetensors").write_bytes(data)
    assert read_policy_file(tmp_path / "policy.safetensors").metadata == {"id": "x"}
