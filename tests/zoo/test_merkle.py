"""A release's root: whatever is changed, added or removed shows; growth loses no leaf."""

import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from assistax_base.errors import (
    ImmutableError,
    IntegrityError,
    LockError,
    RemoteError,
    SignatureError,
)
from assistax_zoo.shell.main import run
from tests.zoo.conftest import edited
from zoo.history.merkle import leaves, lost_leaves, merkle_root
from zoo.lock import apply_lock
from zoo.locking import make_lock
from zoo.registry import Registry, load_registry
from zoo.saving import save_registry
from zoo.splitting.create import create_split
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import remote_registry
from zoo.verify import verify

TEAM = "scratch/ippo-d1-s0-v0"


def remove_team(data: dict[str, Any]) -> None:
    del data["teams"][TEAM]


CHANGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "self-play": lambda d: d["teams"][TEAM]["self_play"].update(mean=951.0),
    "success": lambda d: d["teams"][TEAM]["self_play"].update(success=1.0),
    "provenance": lambda d: d["runs"]["scratch-ippo"].update(steps=7),
    "hyperparameter": lambda d: d["runs"]["scratch-ippo"]["hyperparameters"].update(anneal_lr=True),
    "split": lambda d: (d["splits"].clear(), d["releases"]["v0"]["splits"].clear()),
    "team": remove_team,
    "setting": lambda d: d["disability_settings"]["d9"].update(tremor=0.25),
    "version": lambda d: d["releases"]["v0"]["environments"].update(scratch=2),
    "no root": lambda d: d["releases"]["v0"].pop("root"),
    "description": lambda d: d["releases"]["v0"].update(description="better"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_changed_entry_no_longer_passes_verify(
    registry: Registry, what: str, tmp_path: Path, capsys
) -> None:
    root = registry.root("v0")
    assert registry.data.releases["v0"].root == root and verify(registry).ok
    changed = edited(registry, CHANGES[what])
    assert (changed.root("v0") != root) == (what != "no root")
    assert any("expected root" in problem for problem in verify(changed).problems)
    out, task = ["--out", str(tmp_path / "out")], ["--task", "scratch"]
    for words in (
        ["list"],
        ["show", TEAM],
        ["evaluate", *task, "zero", *out],
        ["crossplay", *task, *out],
        ["lock", *out],
        ["export", f"{TEAM}/robot", "--format", "safetensors", *out],
        ["split", "create", *task, "--seed", "1"],
        ["cite"],
    ):
        assert run([*words, "--registry", str(registry.path)]) == 1
        assert "expected root" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_tree_tells_leaves_from_nodes_and_order() -> None:
    digests = [hashlib.sha256(bytes([n])).hexdigest() for n in range(5)]
    assert merkle_root(digests[:1]) == digests[0]
    roots = {merkle_root(digests[:n]) for n in range(1, 6)} | {merkle_root(reversed(digests))}
    assert len(roots) == 6
    pair = hashlib.sha256(b"\x01" + bytes.fromhex(digests[0] + digests[1])).hexdigest()
    assert merkle_root(digests[:2]) == pair


def test_growth_keeps_every_leaf(registry: Registry, teams, publish_to) -> None:
    before, old = leaves(registry.data, "v0"), registry.data
    grown = publish_to(teams(seeds=range(6)), registry.path)
    assert not lost_leaves(old, grown.data)
    assert before.items() - leaves(grown.data, "v0").items() == {
        ("release v0", before["release v0"])
    }
    assert grown.root("v0") != merkle_root(before.values()) and verify(grown).ok


def test_what_was_published_cannot_be_saved_away(registry: Registry) -> None:
    split = create_split(registry.path, task="scratch", seed=1)
    now = load_registry(registry.path)
    fewer = now.data.model_copy(
        update={"splits": tuple(kept for kept in now.splits if kept.id != split.id)}
    )
    with pytest.raises(ImmutableError, match=f"split {split.id} gone or changed"):
        save_registry(fewer, registry.path)
    assert load_registry(registry.path) == now


def test_a_lock_pins_figures_and_provenance(registry: Registry, teams, publish_to) -> None:
    lock = make_lock(registry, registry.policies)
    few = apply_lock(registry, make_lock(registry, registry.policies[:2]), task="scratch")
    assert len(few.policies) == 2 and few.root("v0") == registry.root("v0")
    assert lock.root == registry.root("v0") and f"team {TEAM}" in lock.leaves
    apply_lock(publish_to(teams(seeds=range(6)), registry.path), lock, task="scratch")
    for what in ("self-play", "provenance"):
        text = registry.path.read_text()
        with pytest.raises(LockError, match="expected entry"):
            apply_lock(edited(registry, CHANGES[what]), lock, task="scratch")
        registry.path.write_text(text)


def test_a_fetch_tells_a_rewritten_history(registry: Registry, cache: Path) -> None:
    remote = open_remote(registry.path.parent)
    kept = remote_registry(remote)
    with pytest.raises(IntegrityError, match="content of its own roots"):
        edited(registry, CHANGES["self-play"])
        remote_registry(remote)
    changed = load_registry(registry.path, roots=False).data
    registry.path.unlink()
    save_registry(changed, registry.path)  # a forger who corrects the roots as well
    with pytest.raises(IntegrityError, match=r"another history: team .* gone or changed"):
        remote_registry(remote)
    assert load_registry(kept.path).root("v0") == kept.root("v0")


def test_a_release_is_signed_and_verified(
    registry: Registry, teams, publish_to, tmp_path: Path, capsys
) -> None:
    private, public = write_keys(tmp_path, "mine")
    signed = publish_to(teams(), registry.path, key=private)
    assert verify(signed, key=public).ok
    assert "not signed by" in verify(signed, key=write_keys(tmp_path, "other")[1]).problems[0]
    grown = publish_to(teams(seeds=range(5)), registry.path)
    assert "is not signed" in verify(grown, key=public).problems[0]
    publish_to(teams(), registry.path, key=private)
    assert run(["verify", "--registry", str(registry.path), "--key", str(public)]) == 0
    changed = edited(registry, CHANGES["self-play"])
    assert any("not signed by" in problem for problem in verify(changed, key=public).problems)
    for key in (private, tmp_path / "none.pem"):
        with pytest.raises(SignatureError, match="Ed25519 public key"):
            verify(registry, key=key)


def write_keys(folder: Path, name: str) -> tuple[Path, Path]:
    """Return the files of a private and of its public key."""
    from cryptography.hazmat.primitives import serialization as form
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key, paths = Ed25519PrivateKey.generate(), (folder / f"{name}.pem", folder / f"{name}.pub.pem")
    pem, plain = form.Encoding.PEM, form.NoEncryption()
    paths[0].write_bytes(key.private_bytes(pem, form.PrivateFormat.PKCS8, plain))
    paths[1].write_bytes(key.public_key().public_bytes(pem, form.PublicFormat.SubjectPublicKeyInfo))
    return paths


def test_missing_package_names_its_extra(registry: Registry, monkeypatch) -> None:
    for package in ("cryptography", "fsspec"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ValueError, match=r"pip install 'assistax-zoo\[sign\]'"):
        verify(registry, key=registry.path)
    with pytest.raises(RemoteError, match=r"pip install 'assistax-zoo\[remotes\]'"):
        remote_registry(open_remote("s3://bucket/zoo"))
