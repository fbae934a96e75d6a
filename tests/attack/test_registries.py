"""Registries that somebody altered with sense, re-rooted or not: nothing false is used.

Not re-rooted, none is opened. Re-rooted, each is another registry: a lock of the true one refuses
it or pins what it pinned, and a second `add` refuses it, or shows what it gives by default.
"""

import copy
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.attack.ledger import attack
from tests.attack.test_damage import REFUSALS, told
from zoo.history.merkle import with_roots
from zoo.lock import apply_lock
from zoo.locking import make_lock
from zoo.registry import build_registry, load_registry, parse_registry
from zoo.saving import dump_registry
from zoo.schema import RegistryFile
from zoo.transport.other_zoos import add

pytestmark = pytest.mark.attack
Data = dict[str, Any]


def stronger(data: Data, rng: random.Random) -> None:
    data["disability_settings"][rng.choice(["d1", "d9"])]["strength"] = rng.uniform(0.1, 0.9)


def unused_setting(data: Data, rng: random.Random) -> None:
    data["disability_settings"][rng.choice(["d2", "d5"])]["strength"] = rng.uniform(0.1, 0.9)


def sides_exchanged(data: Data, rng: random.Random) -> None:
    split = rng.choice(data["splits"])
    split["train"], split["test"] = split["test"], split["train"]


def fewer_partners(data: Data, rng: random.Random) -> None:
    rng.choice(data["splits"])[rng.choice(["train", "test"])].pop()


def without_split(data: Data, rng: random.Random) -> None:
    data["splits"].clear()
    data["releases"]["v0"].pop("splits")


def teams_renamed(data: Data, rng: random.Random) -> None:
    first, second = rng.sample(sorted(data["teams"]), 2)
    data["teams"][first], data["teams"][second] = data["teams"][second], data["teams"][first]


def team_gone(data: Data, rng: random.Random) -> None:
    del data["teams"][rng.choice(sorted(data["teams"]))]


def team_more(data: Data, rng: random.Random) -> None:
    name = rng.choice(sorted(data["teams"]))
    more = name.replace("-s0-", "-s7-").replace("-s1-", "-s9-")
    data["teams"][more] = copy.deepcopy(data["teams"][name])


def human_of_another(data: Data, rng: random.Random) -> None:
    first, second = rng.sample(sorted(data["teams"]), 2)
    teams = data["teams"]
    teams[first]["policies"]["human"] = teams[second]["policies"]["human"]


def longer_training(data: Data, rng: random.Random) -> None:
    rng.choice(list(data["runs"].values()))["steps"] = rng.randrange(10**9)


def environment(data: Data, rng: random.Random) -> None:
    data["releases"]["v0"]["environments"]["scratch"] = rng.randrange(2, 9)


def record(data: Data, rng: random.Random) -> None:
    data["releases"]["v0"].update(date="2027-02-01", description=f"as before {rng.random()}")


def shard(data: Data, rng: random.Random) -> None:
    rng.choice(list(data["shards"].values()))["sha256"] = f"{rng.randrange(16**64):064x}"


ALTERATIONS: list[Callable[[Data, random.Random], None]] = [
    *(stronger, unused_setting, sides_exchanged, fewer_partners, without_split, teams_renamed),
    *(team_gone, team_more, human_of_another, longer_training, environment, record, shard),
]


def altered(whole: str, rng: random.Random) -> str:
    """Return the registry with one to three alterations."""
    data = json.loads(whole)
    changes = rng.sample(ALTERATIONS, rng.randint(1, 3))
    for change in sorted(changes, key=lambda change: change is without_split):  # that one last
        change(data, rng)
    return json.dumps(data)


def rooted(text: str) -> str:
    """Return the registry as a forger publishes it who knows of roots."""
    return dump_registry(with_roots(parse_registry(text, "altered")))


def used(data: RegistryFile) -> dict[str, Any]:
    """Return what figures depend on: policies with settings, and splits."""
    entries = build_registry(data, Path("registry.json")).policies
    policies = {
        entry.id: (entry.sha256, entry.setting, entry.self_play, entry.training.steps)
        for entry in entries
    }
    return {"policies": policies, "splits": data.splits, "defaults": data.releases["v0"].splits}


def test_altered_registries_are_not_opened(registry_path: Path, tmp_path: Path) -> None:
    true, path = load_registry(registry_path), tmp_path / "registry.json"
    with attack("altered registries") as ledger:
        for trial in range(ledger.wanted(600)):
            path.write_text(altered(registry_path.read_text(), ledger.random))
            with ledger.trial(f"altered registry {trial}"):
                try:
                    read = load_registry(path)
                except REFUSALS as error:
                    told(error)
                else:  # what no release uses is in no root
                    assert used(read.data) == used(true.data), "an altered registry is opened"


def test_lock_refuses_a_remade_registry(registry_path: Path, tmp_path: Path) -> None:
    true, path = load_registry(registry_path), tmp_path / "registry.json"
    lock = make_lock(true, true.policies)
    expected = used(apply_lock(true, lock, task="scratch").data)
    with attack("re-rooted registries under a lock") as ledger:
        for trial in range(ledger.wanted(600)):
            text = altered(registry_path.read_text(), ledger.random)
            with ledger.trial(f"re-rooted registry {trial}"):
                try:
                    path.write_text(rooted(text))
                    locked = apply_lock(load_registry(path), lock, task="scratch")
                except REFUSALS as error:
                    told(error)
                else:
                    assert used(locked.data) == expected, "a lock takes other entries"


def test_a_second_add_takes_no_other_default_unasked(
    registry_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ASSISTAX_ZOO_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("ASSISTAX_ZOO_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(registry_path))
    remote, whole = tmp_path / "remote" / "registry.json", registry_path.read_text()
    remote.parent.mkdir()
    with attack("a second add of a re-rooted zoo") as ledger:
        for trial in range(ledger.wanted(300)):
            for folder in ("data", "cache"):
                for old in (tmp_path / folder).rglob("registry.json"):
                    old.unlink()
            remote.write_text(whole)
            before = used(add(str(remote.parent), "lab").data)
            text = altered(whole, ledger.random)
            with ledger.trial(f"a second add {trial}"):
                try:
                    remote.write_text(rooted(text))
                    now = used(add(str(remote.parent), "lab").data)
                except REFUSALS as error:
                    told(error)
                else:
                    kept = {name: now["policies"].get(name) for name in before["policies"]}
                    assert kept == before["policies"], "a policy is another"
                    assert now["defaults"] == before["defaults"], "another default, unasked"


def test_harness_finds_a_lock_of_names_alone(
    registry_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The planted defect of this family."""
    # The check is taken away: nothing public can.
    monkeypatch.setattr("zoo.lock._check", lambda registry, lock: None)
    with pytest.raises(AssertionError):
        test_lock_refuses_a_remade_registry(registry_path, tmp_path)
