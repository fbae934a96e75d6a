from pathlib import Path
from typing import Any

import pytest

from assistax_base.errors import (
    RegistryError,
    RegistryVersionError,
    SplitError,
    UnknownIdError,
)
from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.cast.cast import in_release
from population.networks.spec import spec_from_json
from tests.zoo.conftest import edit, edited, put, trained_teams
from zoo.registry import Registry, load_registry, parse_registry
from zoo.saving import dump_registry, save_registry
from zoo.schema import SCHEMA_VERSION

TEAM = "scratch/ippo-d1-s0-v0"


def copy_team(data: dict[str, Any], name: str) -> None:
    data["teams"][name] = data["teams"][TEAM]


def set_default(data: dict[str, Any], **splits: str) -> None:
    data["releases"]["v0"]["splits"].update(splits)


def test_round_trip_keeps_every_value_and_byte(registry: Registry) -> None:
    text = registry.path.read_text()
    assert dump_registry(parse_registry(text, "test")) == text
    assert load_registry(registry.path) == registry


def test_entries_carry_what_the_evaluator_reads(registry: Registry, specs) -> None:
    entry = registry.policy("scratch/ippo-d9-s2-v0/human")
    assert (entry.team, entry.task, entry.algorithm) == ("scratch/ippo-d9-s2-v0", "scratch", "ippo")
    assert (entry.role, entry.disability, entry.seed, entry.release) == ("human", "d9", 2, "v0")
    assert entry.spec == specs["human"] and entry.training.steps == 10_000_000
    assert entry.training.hyperparameters == {"anneal_lr": False, "learning_rate": 1e-3}
    assert entry.self_play is not None and entry.self_play.mean_ci == (940.0, 960.0)
    assert [e.id for e in registry.policies[:2]] == [f"{TEAM}/robot", f"{TEAM}/human"]
    assert len(registry.data.runs) == 1  # provenance is stored once


def test_entries_carry_their_registrys_setting(registry: Registry) -> None:
    def weaken(data: dict) -> None:
        data["disability_settings"]["d9"]["strength"] = 0.125

    changed = edited(registry, weaken)
    assert changed.policy("scratch/ippo-d9-s2-v0/human").partner_setting.strength == 0.125
    assert changed.policy("scratch/ippo-d1-s2-v0/human").setting == DISABILITY_SETTINGS["d1"]

    def impossible(data: dict) -> None:
        data["disability_settings"]["d9"]["strength"] = 0.0

    with pytest.raises(RegistryError, match=r"disability_settings.d9: .*share in \(0, 1\]"):
        load_registry(edit(registry, impossible))


def test_selection_by_glob_and_field(registry: Registry) -> None:
    humans = registry.select("scratch/ippo-*/human")
    assert len(humans) == 8 and {entry.role for entry in humans} == {"human"}
    assert registry.select(role="human") == humans
    assert [e.role for e in registry.select("scratch/ippo-d1-s0-v0")] == ["robot", "human"]
    both = registry.select(["*-d9-s1-*/robot", "scratch/ippo-d1-s3-v0/robot"])
    assert [e.id for e in both] == ["scratch/ippo-d1-s3-v0/robot", "scratch/ippo-d9-s1-v0/robot"]
    fields = {"disability": "d9", "release": "v0", "task": "scratch", "algorithm": "ippo"}
    assert len(registry.select(**fields)) == 8


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        ({"pattern": "scratch/ipo-d1-s0-v0/human"}, "scratch/ippo-d1-s0-v0/human"),
        ({"pattern": "scratch/mappo-*"}, "nearest"),
        ({"pattern": ["*", "nothing"]}, "nothing"),
        ({"task": "scrach"}, "scratch"),
        ({"algorithm": "mappo"}, "ippo"),
        ({"disability": "d3"}, "d1, d9"),
        ({"release": "v7"}, "v0"),
        ({"role": "nurse"}, "human, robot"),
    ],
)
def test_what_matches_nothing_names_the_nearest(
    registry: Registry, arguments: dict, hint: str
) -> None:
    with pytest.raises(UnknownIdError, match=hint):
        registry.select(**arguments)
    with pytest.raises(UnknownIdError, match=f"{TEAM}/human"):
        registry.policy(f"{TEAM}/humans")
    with pytest.raises(UnknownIdError, match=TEAM):
        registry.team("scratch/ippo-d1-s0-v1")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(colour="red"), "unknown field colour"),
        (lambda d: d["shards"].popitem(), "shard .* is not among"),
        (lambda d: d["teams"][TEAM].update(mood=1), "unknown field teams.*mood"),
        (lambda d: copy_team(d, "scratch/ippo-d1-s0"), "team id"),
        (lambda d: copy_team(d, "scratch/ippo-d1-s9-v7"), "release 'v7'"),
        (lambda d: copy_team(d, "scratch/isac-d1-s0-v0"), "points to a"),
        (lambda d: d["teams"][TEAM]["policies"]["robot"].update(row=99), "row 99"),
        (lambda d: d["teams"][TEAM]["policies"]["robot"].update(row="0"), "valid integer"),
        (lambda d: d["teams"][TEAM].update(policies={}), "at least 1"),
        (lambda d: d["disability_settings"].pop("d9"), "'d9' is not among"),
        (lambda d: set_default(d, scratch="scratch/half-s0-v0-00000000"), "is not among"),
        (lambda d: d["splits"].append(d["splits"][0]), "occurs twice"),
        (lambda d: set_default(d, bed_bath=d["splits"][0]["id"]), "a split of"),
        (lambda d: d.pop("teams"), "teams is missing"),
        (lambda d: d.update(release="v9"), "release 'v9'"),
        (lambda d: d.update(schema_version=1), "it must be 2"),
        (lambda d: d.update(schema_version="1"), "schema_version '1'"),
    ],
)
def test_planted_defects_are_refused_in_one_line(registry: Registry, change, words: str) -> None:
    with pytest.raises(RegistryError, match=words) as caught:
        load_registry(edit(registry, change))
    assert "\n" not in str(caught.value) and "restore" in str(caught.value)


@pytest.mark.parametrize(
    "path", ["../outside.safetensors", "/etc/shadow.safetensors", "a/../b.safetensors", "x.pkl"]
)
def test_shard_paths_stay_below_the_registry(registry: Registry, path: str) -> None:
    shard = registry.policies[0].shard

    def change(data: dict[str, Any]) -> None:
        data["shards"][path] = data["shards"].pop(shard)

    with pytest.raises(RegistryError):
        load_registry(edit(registry, change))


def test_newer_schema_says_upgrade(registry: Registry) -> None:
    path = edit(registry, lambda d: d.update(schema_version=SCHEMA_VERSION + 1, news=[]))
    with pytest.raises(RegistryVersionError, match="upgrade"):
        load_registry(path)


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b"null", b"{}", b"\xff\xfe", b"[" * 100_000])
def test_what_is_no_registry_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "registry.json"
    path.write_bytes(data)
    with pytest.raises(RegistryError, match=r"registry\.json"):
        load_registry(path)


def test_registry_of_environment_variable(registry: Registry, tmp_path: Path, monkeypatch) -> None:
    with pytest.raises(RegistryError, match="no such file"):
        load_registry(tmp_path / "absent.json")
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(registry.path))
    assert load_registry() == registry


def test_specs_are_held_to_their_types() -> None:
    good = {"role": "robot", "observation_size": 5, "action_size": 2, "hidden": [4]}
    assert spec_from_json(good).hidden == (4,)
    for bad in (
        {**good, "observation_size": "5"},
        {**good, "observation_size": 5.0},
        {**good, "action_size": True},
        {**good, "hidden": [4.5]},
        {**good, "hidden": "44"},
        {**good, "normalise": 1},
        {**good, "colour": "red"},
        {"role": "robot"},
        [],
        None,
    ):
        with pytest.raises(ValueError, match="spec"):
            spec_from_json(bad)


def test_saving_refuses_what_would_not_load(registry: Registry) -> None:
    before = registry.path.read_bytes()
    broken = registry.data.model_copy(update={"release": "v9"})
    with pytest.raises(RegistryError):
        save_registry(broken, registry.path)
    assert registry.path.read_bytes() == before
    assert not list(registry.path.parent.glob(".*tmp"))


def test_split_lookup(registry: Registry) -> None:
    default = registry.split("scratch")
    assert default.rule == "half" and len(default.train) == len(default.test) == 4
    assert registry.split("scratch", default.id) == registry.split("scratch", "half-s0") == default
    for arguments in (("scratch", "half-s1"), ("bed_bath",)):
        with pytest.raises(SplitError, match="split create"):
            registry.split(*arguments)
    with pytest.raises(SplitError, match="v0"):
        registry.split("scratch", release="v5")


def test_a_name_without_a_release_is_of_the_release_that_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "registry.json"
    put(trained_teams(), path)
    both, team = put(trained_teams(), path, "v1"), "scratch/ippo-d1-s0"
    assert [entry.team for entry in both.select(team, role="human")] == [f"{team}-v1"]
    assert [e.team for e in both.select(team, role="human", release="v0")] == [f"{team}-v0"]
    [human] = in_release(both, team, "v0", task="scratch", role="human")
    assert human.team == f"{team}-v0"
