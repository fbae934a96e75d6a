"""Selection, registries and splits, over random populations, against plain re-statements."""

import fnmatch
import json
import random
from pathlib import Path

import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from assistax_base.errors import UnknownIdError, ZooError
from population.networks.spec import PolicySpec
from zoo.ids import TeamId
from zoo.registry import Registry, build_registry, parse_registry
from zoo.saving import dump_registry
from zoo.schema import SCHEMA_VERSION, RegistryFile
from zoo.selection import FIELDS, select
from zoo.splits import check_split
from zoo.splitting.rules import make_split

SPEC = PolicySpec("human", 6, 3, hidden=(4,))
TEAMS = st.builds(
    TeamId,
    task=st.sampled_from(["scratch", "bed_bath"]),
    algorithm=st.sampled_from(["ippo", "masac", "mappo"]),
    disability=st.sampled_from(["d1", "d2", "d9"]),
    seed=st.integers(0, 12),
    release=st.sampled_from(["v0", "v1"]),
)
POPULATIONS = st.lists(TEAMS, min_size=1, max_size=30, unique=True)
GLOBS = st.lists(
    st.sampled_from(
        ["*", "?", "scratch/", "ippo-", "d[19]", "-s1", "-v0", "/human", "/robot", "IPPO-"]
    ),
    max_size=5,
)
VALUES = st.sampled_from(["d1", "ippo", "v0", "scratch", "human"])
FILTERS = st.dictionaries(st.sampled_from(FIELDS), VALUES, max_size=2)
SETTINGS = settings(deadline=None, max_examples=150, derandomize=True)


def registry_of(teams: list[TeamId]) -> Registry:
    """Return a registry of human-only teams, one shard for each task, algorithm and release."""
    shards: dict = {}
    entries: dict = {}
    for number, team in enumerate(teams):
        path = f"zoo/shards/{team.release}/{team.task}-{team.algorithm}.safetensors"
        shard = shards.setdefault(path, {
            "sha256": "a" * 64, "bytes": 9, "task": team.task, "algorithm": team.algorithm,
            "role": "human",
            "release": team.release, "rows": 0, "spec": SPEC.to_json(),
        })  # fmt: skip
        row = {"shard": path, "row": shard["rows"], "sha256": f"{number:064x}"}
        shard["rows"] += 1
        entries[str(team)] = {"run": "r", "policies": {"human": row}}
    released = {team.release for team in teams}
    data = {
        "schema_version": SCHEMA_VERSION,
        "release": max(released),
        "releases": {
            name: {"date": "2027-01-31", "environments": {"scratch": 1, "bed_bath": 1}}
            for name in released
        },
        "disability_settings": {
            d: {"strength": 1.0, "elbow_range": 1.0, "tremor": 0.0} for d in ("d1", "d2", "d9")
        },
        "runs": {"r": {"steps": 1, "env_version": 1, "backend": "native"}},
        "shards": shards,
        "teams": entries,
    }
    return build_registry(RegistryFile.model_validate_json(json.dumps(data)), Path("registry.json"))


@SETTINGS
@seed(1)
@given(POPULATIONS, st.lists(GLOBS.map("".join), min_size=1, max_size=2), FILTERS)
def test_selection_is_the_plain_filter(
    teams: list[TeamId], patterns: list[str], fields: dict[str, str]
) -> None:
    entries = registry_of(teams).policies
    fitting = [e for e in entries if all(getattr(e, name) == fields[name] for name in fields)]
    matches = [
        {e.id for e in fitting if any(fnmatch.fnmatchcase(name, glob) for name in (e.id, e.team))}
        for glob in patterns
    ]
    if all(matches):
        expected = [entry for entry in fitting if entry.id in set().union(*matches)]
        assert select(entries, patterns, **fields) == expected
    else:
        with pytest.raises(UnknownIdError) as caught:
            select(entries, patterns, **fields)
        assert str(caught.value).isprintable()


@pytest.mark.slow
@SETTINGS
@seed(3)
@given(POPULATIONS, st.randoms(use_true_random=False))
def test_registries_round_trip_whatever_their_order(
    teams: list[TeamId], rng: random.Random
) -> None:
    registry = registry_of(teams)
    text = dump_registry(registry.data)
    again = parse_registry(text, "test")
    assert again == registry.data and dump_registry(again) == text
    data = json.loads(text)
    for table in ("teams", "shards", "releases"):
        items = list(data[table].items())
        rng.shuffle(items)
        data[table] = dict(items)
    shuffled = parse_registry(json.dumps(data), "test")
    assert dump_registry(shuffled) == text
    assert build_registry(shuffled, registry.path).policies == registry.policies


@SETTINGS
@seed(4)
@given(
    POPULATIONS,
    st.sampled_from(["half", "leave-one-algorithm-out", "leave-one-disability-out", "small-train"]),
    st.integers(0, 5),
    st.randoms(use_true_random=False),
)
def test_every_rule_covers_ignores_order_and_other_releases(
    teams, rule: str, number: int, rng: random.Random
) -> None:
    held_out = {"leave-one-algorithm-out": "ippo", "leave-one-disability-out": "d9"}.get(rule)
    ids = [str(team) for team in teams]
    arguments = {"task": "scratch", "release": "v0", "rule": rule, "seed": number, "n": 1}
    arguments["held_out"] = held_out
    try:
        split = make_split(ids, **arguments)
    except ZooError as error:
        assert str(error).isprintable()
        return
    check_split(split)
    allowed = {str(team) for team in teams if (team.task, team.release) == ("scratch", "v0")}
    assert not set(split.train) & set(split.test) and {*split.train, *split.test} <= allowed
    assert rule == "small-train" or {*split.train, *split.test} == allowed
    shuffled = [text for text in ids if text in allowed]
    rng.shuffle(shuffled)
    assert make_split(shuffled, **arguments) == split
