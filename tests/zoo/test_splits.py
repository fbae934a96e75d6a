import random
import statistics
from typing import Any

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from assistax_base.digest import json_sha256
from assistax_base.errors import LeakageError, SplitError
from tests.zoo.conftest import edited
from zoo.history.merkle import with_roots
from zoo.ids import parse_team
from zoo.partners.sides import parse_split
from zoo.registry import Registry, load_registry
from zoo.saving import dump_registry
from zoo.splits import check_split, competent, shared_parameters, split_id
from zoo.splitting.create import create_split
from zoo.splitting.rules import half_side, make_split


def ids(
    algorithms=("ippo", "mappo"), disabilities=range(1, 10), seeds=range(8), release="v1"
) -> list[str]:
    return [
        f"scratch/{a}-d{d}-s{s}-{release}" for a in algorithms for d in disabilities for s in seeds
    ]


def make(teams, rule="half", **arguments):
    return make_split(teams, task="scratch", release="v1", rule=rule, **arguments)


def test_half_is_exact_in_every_stratum() -> None:
    split = make(ids())
    assert len(split.train) == len(split.test) == 72
    for algorithm in ("ippo", "mappo"):
        for setting in range(1, 10):
            stratum = [team for team in split.train if f"/{algorithm}-d{setting}-" in team]
            assert len(stratum) == 4


@seed(4)
@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 99), st.integers(1, 12), st.lists(st.integers(0, 11), unique=True), st.randoms()
)
def test_half_ignores_order_and_growth(
    split_seed: int, seeds: int, later: list[int], shuffle: random.Random
) -> None:
    small = ids(("ippo",), (1, 9), range(seeds))
    grown = [*small, *ids(("ippo", "masac"), (1, 2, 9), later), *ids(release="v2")]
    shuffled = sorted(grown, key=lambda _: shuffle.random())
    side = {team: half_side(parse_team(team), split_seed) for team in small}
    if len(set(side.values())) < 2:
        return
    before, after = make(small, seed=split_seed), make(shuffled, seed=split_seed)
    assert make(sorted(grown), seed=split_seed) == after
    assert all(after.side(team) == before.side(team) == side[team] for team in small)
    assert not any(team.endswith("-v2") for team in (*after.train, *after.test))


def test_half_is_random_in_the_seed() -> None:
    sides = [make(ids(("ippo",), (1,)), seed=n).train for n in range(20)]
    assert len(set(sides)) > 5
    odd = [len(make(ids(("ippo",), range(1, 10), range(5)), seed=n).train) for n in range(40)]
    # The odd team of each stratum falls to either side.
    assert 18 <= min(odd) < 22 and 23 < max(odd) <= 27


def test_leave_one_out() -> None:
    split = make(ids(), "leave-one-algorithm-out", held_out="mappo")
    assert split.id.startswith("scratch/without-mappo-s0-v1-")
    assert {parse_team(team).algorithm for team in split.test} == {"mappo"}
    assert len(split.test) == 72
    split = make(ids(), "leave-one-disability-out", held_out="d9")
    assert {parse_team(team).disability for team in split.test} == {"d9"}
    assert len(split.train) == 128


def test_small_train_keeps_the_test_side_of_half() -> None:
    half, small = make(ids(), seed=3), make(ids(), "small-train", n=5, seed=3)
    assert small.test == half.test and len(small.train) == 5 and set(small.train) < set(half.train)
    assert small.id.startswith("scratch/small-5-s3-v1-")


def test_custom_sides_are_sorted_and_disjoint() -> None:
    teams = ids(("ippo",), (1,))
    split = make(teams, "custom", train=[teams[3], teams[1], teams[3]], test=[teams[0]])
    assert split.train == (teams[1], teams[3]) and split.test == (teams[0],)
    with pytest.raises(LeakageError, match=teams[1]):
        make(teams, "custom", train=teams[:2], test=teams[1:])


@pytest.mark.parametrize(
    ("rule", "arguments", "words"),
    [
        ("third", {}, "one of half"),
        ("leave-one-algorithm-out", {}, "one of ippo, mappo"),
        ("leave-one-disability-out", {"held_out": "d12"}, "one of d1"),
        ("small-train", {"n": 0}, "1 to 72"),
        ("small-train", {"n": 73}, "1 to 72"),
        ("custom", {"train": ["scratch/ippo-d1-s0-v1"]}, "at least one team in test"),
        ("custom", {"train": ["scratch/ippo-d1-s77-v1"], "test": ["scratch/ippo-d1-s0-v1"]}, "s77"),
    ],
)
def test_what_cannot_be_split_is_refused(rule: str, arguments: dict, words: str) -> None:
    with pytest.raises(SplitError, match=words):
        make(ids(), rule, **arguments)


GENTLE = "gentle_lift"


def gentle(rule="leave-one-algorithm-out", **arguments):
    teams = [team.replace("scratch", GENTLE) for team in ids(disabilities=(1, 2))]
    arguments = {"held_out": "mappo", "test_preferences": ("p9", "p1", "p5"), **arguments}
    return make_split(teams, task=GENTLE, release="v1", rule=rule, **arguments)


@pytest.mark.parametrize("rule", ["leave-one-algorithm-out", "half", "small-train"])
def test_preferences_are_held_out_by_any_rule(rule: str) -> None:
    split, without = gentle(rule), gentle(rule, test_preferences=())
    assert split.preferences["test"] == ("p1", "p5", "p9")
    assert split.preferences["train"] == ("p2", "p3", "p4", "p6", "p7", "p8")
    assert (split.train, split.test) == (without.train, without.test)
    assert "-p1-p5-p9-s0-v1-" in split.id and split.sha256 != without.sha256
    few = gentle(rule, train_preferences=["p2"])
    assert few.preferences == {"train": ("p2",), "test": ("p1", "p5", "p9")}
    other = gentle(rule, test_preferences=(), train_preferences=split.preferences["train"])
    assert other == split


def test_split_without_preferences_keeps_its_hash() -> None:
    assert "preferences" not in gentle(test_preferences=()).content
    assert sum(not split.preferences for split in load_registry().splits) >= 42


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"test_preferences": ["p10"]}, "preferences are p10; give each"),
        ({"test_preferences": ["p1", "p1"]}, "preferences are p1, p1; give each"),
        ({"test_preferences": [f"p{k}" for k in range(1, 10)]}, "preferences are none; give each"),
        ({"train_preferences": ["p1", "p2"]}, "no preference on both sides, found p1"),
    ],
)
def test_preferences_that_cannot_be_held_out_are_refused(arguments: dict, words: str) -> None:
    with pytest.raises(SplitError, match=words):
        gentle(**arguments)
    with pytest.raises(SplitError, match="the humans of scratch have no preferences"):
        make(ids(), test_preferences=["p1"])


def test_a_changed_manifest_is_refused(registry: Registry) -> None:
    split = gentle()
    for change in (
        {"train": split.train[1:]},
        {"preferences": {}},
        {"preferences": {**split.preferences, "test": ("p1", "p5")}},
    ):
        with pytest.raises(SplitError, match=f"expected sha256 {split.sha256}, found sha256"):
            check_split(split.model_copy(update=change))
    with pytest.raises(SplitError, match="expected id"):
        check_split(split.model_copy(update={"id": f"{split.id[:-8]}00000000"}))

    def move(data: dict[str, Any]) -> None:
        data["splits"][0]["train"].append(data["splits"][0]["test"].pop())

    with pytest.raises(SplitError, match="sha256"):
        edited(registry, move).split("scratch")


def test_identical_parameters_on_both_sides_leak(registry: Registry) -> None:
    split = registry.split("scratch")
    assert shared_parameters(split.train, split.test, registry.data.teams) == []
    train, test = split.train[0], split.test[0]
    digest = registry.policy(f"{train}/human").sha256

    def copy(data: dict[str, Any]) -> None:
        data["teams"][test]["policies"]["human"]["sha256"] = digest

    leaking = edited(registry, copy)
    with pytest.raises(LeakageError, match=f"{train} = {test}"):
        leaking.split("scratch")
    registry.path.write_text(dump_registry(with_roots(leaking.data)))
    with pytest.raises(LeakageError):
        create_split(registry.path, task="scratch", rule="custom", train=[train], test=[test])


def test_short_split_name_means_newest_release(registry: Registry, team, publish_to) -> None:
    older = registry.split("scratch", "half")
    grown = publish_to([team("ippo", "d1", seed) for seed in range(2)], registry.path, release="v1")
    assert grown.split("scratch", "half").release == "v1"
    assert grown.split("scratch", "half-s0-v0") == older
    create_split(registry.path, task="scratch", rule="half", seed=1, release="v1")
    registry = load_registry(registry.path)
    assert registry.split("scratch", "half") == grown.split("scratch", "half"), "the default one"
    with pytest.raises(SplitError, match="found none"):
        registry.split("scratch", "hal")
    sides = [older.train[:1], older.test[:1]]
    for train, test in (sides, sides[::-1]):
        custom = {"rule": "custom", "train": train, "test": test}
        create_split(registry.path, task="scratch", release="v0", **custom)
    with pytest.raises(SplitError, match="found 2 that begin so"):
        load_registry(registry.path).split("scratch", "custom-s0-v0")


def test_create_writes_once(registry: Registry) -> None:
    held_out = {"task": "scratch", "rule": "leave-one-disability-out", "held_out": "d9"}
    split = create_split(registry.path, **held_out)
    text = registry.path.read_text()
    assert create_split(registry.path, **held_out) == split
    assert registry.path.read_text() == text
    loaded = load_registry(registry.path)
    assert loaded.split("scratch", "without-d9") == split and loaded.split("scratch").rule == "half"
    with pytest.raises(SplitError, match="scratch v0"):
        create_split(registry.path, task="bed_bath")


def test_chosen_default_stays_when_release_grows(registry: Registry, team, publish_to) -> None:
    chosen = {"rule": "leave-one-disability-out", "held_out": "d9", "default": True}
    split = create_split(registry.path, task="scratch", **chosen)
    assert load_registry(registry.path).split("scratch") == split
    grown = publish_to([team(seed=7)], registry.path)
    assert grown.split("scratch") == split
    half = create_split(registry.path, task="scratch", default=True)
    assert load_registry(registry.path).split("scratch") == half and half.rule == "half"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, (None, "test")),
        ("both", (None, "both")),
        ("half-s0", ("half-s0", "test")),
        ("half-s0:train", ("half-s0", "train")),
        ("three-sides:validation", ("three-sides", "validation")),
        ("lab:both", ("lab:", "both")),
        ("lab:half-s0", ("lab:half-s0", "test")),
        ("lab:scratch/half-s0-v0:both", ("lab:scratch/half-s0-v0", "both")),
    ],
)
def test_what_split_asks_for(text: str | None, expected: tuple[str | None, str]) -> None:
    assert parse_split(text, ["", "lab"]) == expected
    with pytest.raises(ValueError, match="after the colon test, train, validation, both are"):
        parse_split("other:half-s0", ["", "lab"])


def three(teams, **arguments):
    return make(teams, "three-sides", **arguments)


def test_three_sides_have_shares_in_every_stratum() -> None:
    split = three(ids(seeds=range(20)))  # 360 teams in 18 strata of 20
    counts = {side: len(teams) for side, teams in split.sides.items()}
    assert counts == {"train": 216, "validation": 54, "test": 90}
    for algorithm in ("ippo", "mappo"):
        for setting in range(1, 10):
            stratum = f"/{algorithm}-d{setting}-"
            dealt = [sum(stratum in team for team in teams) for teams in split.sides.values()]
            assert np.abs(np.array(dealt) - [12, 3, 5]).max() <= 1
    assert sorted(sum(split.sides.values(), ())) == sorted(ids(seeds=range(20)))
    assert three(ids(seeds=range(20))[::-1]) == split
    assert three(ids(seeds=range(20)), seed=1).id != split.id
    with pytest.raises(SplitError, match="5 teams or more"):
        three(ids(("ippo",), (1,), range(2)))


def test_three_sides_stratify_by_convention_group_too() -> None:
    teams = ids(("ippo",), (1,), range(40))
    groups = {team: "a" if parse_team(team).seed % 4 else "b" for team in teams}  # 30 and 10
    split = three(teams, groups=groups)
    of_b = [sum(groups[team] == "b" for team in side) for side in split.sides.values()]
    assert np.abs(np.array(of_b) - [6, 1.5, 2.5]).max() <= 1


def test_held_out_preferences_make_another_split() -> None:
    teams = [f"gentle_lift/mappo-d{d}-s{s}-v1" for d in (1, 2) for s in range(10)]
    arguments = {"task": "gentle_lift", "release": "v1", "rule": "three-sides"}
    plain, held = (
        make_split(teams, test_preferences=names, **arguments) for names in ((), ("p1", "p5", "p9"))
    )
    assert plain.sides == held.sides and plain.id != held.id and not plain.preferences
    assert held.preferences["validation"] == held.preferences["train"]
    assert "p1" not in held.preferences["train"] and held.preferences["test"] == ("p1", "p5", "p9")
    assert "three-sides-p1-p5-p9-s0-v1" in held.id


def test_splits_of_two_sides_keep_their_content() -> None:
    split = make(ids())
    assert "validation" not in split.content and list(split.sides) == ["train", "test"]
    registry = load_registry()
    for published in registry.splits:
        check_split(published)
    written = dump_registry(registry.part("").data).count('"validation"')
    three_sided = [name for name in registry.data.splits if name.rule == "three-sides"]
    assert written == len(three_sided) == sum(bool(name.validation) for name in three_sided)


def test_team_on_two_sides_is_refused() -> None:
    split = three(ids())
    for one, other in (("train", "validation"), ("validation", "test"), ("train", "test")):
        team = getattr(split, one)[0]
        twice: dict[str, Any] = {other: tuple(sorted((*getattr(split, other), team)))}
        content = split.model_copy(update=twice).content
        twice |= {"sha256": json_sha256(content), "id": split_id(content)}
        with pytest.raises(LeakageError, match=team):
            check_split(split.model_copy(update=twice))


def test_partners_with_whom_nobody_earns_much_leave() -> None:
    data = load_registry().part("").data
    teams = [team for team in data.teams if team.startswith("scratch/ippo-d1-")]
    figures = [(team, data.teams[team].self_play) for team in teams]
    earned = {team: figure.mean for team, figure in figures if figure is not None}
    median = statistics.median(earned.values())
    assert competent(data, teams, {}) == [t for t in teams if earned[t] >= 0.25 * median]
    worst = {teams[0]: 0.2 * median, teams[1]: 0.3 * median}  # what best responses earn decides
    left = {*teams} - {*competent(data, teams, worst)}
    assert teams[0] in left and teams[1] not in left
    assert competent(data, teams, dict.fromkeys(teams, -1.0)) == teams


def test_three_sided_split_is_kept_and_found(registry: Registry) -> None:
    split = create_split(registry.path, task="scratch", rule="three-sides", release="v0")
    again = load_registry(registry.path).split("scratch", "three-sides")
    assert again == split and len(split.validation) == 1
