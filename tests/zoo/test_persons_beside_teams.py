"""Splits of persons whose release holds teams of the task: who is dealt, asked for and locked."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from assistax_base.errors import LockError, SplitError, UnknownIdError
from assistax_workshop.press.publish import publish
from assistax_zoo.commands.partners.split import list_splits
from assistax_zoo.vector_envs import vector_env
from evaluation.cast.cast import choose_partners, groups_beside_teams
from evaluation.ego_training import prepare
from evaluation.training_partners import load_partners
from population.runs.trained import TrainedTeam
from tests.zoo.conftest import SELF_PLAY, put, trained_team
from zoo.lock import apply_lock, read_lock
from zoo.locking import make_lock, write_lock
from zoo.met.claims import declared_met
from zoo.met.published import made_split_met
from zoo.namespaces import merge
from zoo.partners.kinds import kinds
from zoo.partners.person_ids import is_team
from zoo.partners.person_tables import person_splits
from zoo.registry import Registry, load_registry
from zoo.schema import Split, TrainedAgainst
from zoo.splits import check_split
from zoo.verify import verify

TASK = "gentle_scratch"
ALONE = f"{TASK}/persons-s0-v1-956a2b0d"  # of a release without teams
# Self-play of teams by seed: seed 1 is below a quarter of the median, and the last is just there.
EARNED = (100.0, 24.9, 120.0, 100.0, 25.0, 100.0, 110.0, 100.0)
LEARNED, TESTED = (
    [f"{TASK}/ippo-d1-s{n}-v1" for n in seeds] for seeds in ((0, 3, 6), (2, 4, 5, 7))
)


def published(folder: Path, earned: Sequence[float] = EARNED) -> Registry:
    """Publish the persons of the task, and a team for each return, in one release."""
    return put(teams_of(earned), folder / "registry.json", "v1", persons=[TASK])


def teams_of(earned: Sequence[float], first: int = 0) -> list[TrainedTeam]:
    return [
        trained_team(
            seed=seed, task=TASK, self_play={**SELF_PLAY, "mean": mean, "mean_ci": [0, mean]}
        )
        for seed, mean in enumerate(earned, first)
    ]


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    return published(tmp_path_factory.mktemp("mixed"))


def teams_in(entries: Sequence) -> list[str]:
    return [entry.team for entry in entries if is_team(entry.id)]


def alone(registry: Registry) -> Split:
    return registry.split(TASK, ALONE)


def test_competent_teams_are_on_two_sides(mixed: Registry) -> None:
    split = mixed.split(TASK)
    check_split(split)
    assert [team for team in split.test if is_team(team)] == TESTED
    assert {*split.train} == {*alone(mixed).train, *LEARNED}
    assert split.validation == alone(mixed).validation
    assert {*split.test} == {*alone(mixed).test, *TESTED}
    assert mixed.split(TASK, "persons") == mixed.split(TASK, "persons-s0-v1") == split
    assert mixed.source_of_split(split).word == "persons"
    assert mixed.data.releases["v1"].splits == {}, "no half of the teams is the default"
    groups = ("known families", "unseen family", "teams")
    assert (groups_beside_teams(split), groups_beside_teams(alone(mixed))) == (groups, ())
    report = verify(mixed)
    assert report.ok and not report.notes, (report.problems, report.notes)


def test_release_without_teams_has_the_split_that_it_had(tmp_path: Path) -> None:
    bare = publish([], tmp_path / "registry.json", "v1", date="2027-01-31", persons=[TASK])
    assert [split.id for split in person_splits(bare.data, TASK)] == [ALONE]
    _, humans = choose_partners(bare, TASK, None, None, 6)
    numbers = [8857, 9536, 18543, 23421, 23904, 24540]
    assert [entry.seed for entry in humans] == numbers


def test_teams_of_another_release_or_zoo_stay_apart(mixed: Registry, tmp_path: Path) -> None:
    bare = publish([], tmp_path / "registry.json", "v1", date="2027-01-31", persons=[TASK])
    both = merge(bare.data, {"lab": mixed.data})
    lab = dataclasses.replace(bare, data=both, parts={"": bare, "lab": mixed})
    assert lab.split(TASK).id == ALONE
    theirs = lab.split(TASK, "lab:persons")
    assert [t for t in theirs.test if is_team(t)] == [f"lab:{team}" for team in TESTED]
    assert theirs.sha256 == mixed.split(TASK).sha256


@pytest.mark.parametrize(
    ("split", "patterns", "persons", "teams"),
    [
        (None, None, 4, 2),  # as many as of a group of persons
        ("test", None, 3, 2),
        ("persons:test", None, 50, 4),  # there are no more
        ("validation", None, 4, 0),
        ("train", None, 4, 3),
        ("both", None, 6, 3),
        (None, "persons", 4, 0),
        (None, f"{TASK}/person-09*", 4, 0),
        (None, ["persons", f"{TASK}/ippo-*"], 2, 4),
        (None, [f"{TASK}/ippo-d1-s[0-2]", "persons"], 4, 1),
        (None, [f"{TASK}/person-09*", f"{TASK}/ippo-d1-s3"], 4, 1),
    ],
)
def test_a_user_says_who_plays(mixed: Registry, split, patterns, persons: int, teams: int) -> None:
    dealt, humans = choose_partners(mixed, TASK, split, patterns, persons)
    assert dealt == mixed.split(TASK)
    chosen = teams_in(humans)
    assert (len(humans) - len(chosen), len(chosen)) == (persons, teams)
    assert {*chosen} <= {*TESTED, *(LEARNED if patterns or split in ("train", "both") else ())}
    named = [patterns] if isinstance(patterns, str) else patterns or ["persons"]
    others = [text for text in named if "ippo" not in text]
    by_themselves = choose_partners(mixed, TASK, split, others, persons)[1]
    assert humans[len(chosen) :] == by_themselves, "persons are drawn as without teams"


def test_fewer_teams_are_a_part_of_more(mixed: Registry) -> None:
    drawn = [teams_in(choose_partners(mixed, TASK, None, None, most)[1]) for most in (2, 4, 6, 8)]
    assert list(map(len, drawn)) == [1, 2, 3, 4]
    for few, more in itertools.pairwise(drawn):
        assert {*few} < {*more}
    shown = mixed.source_of_split(mixed.split(TASK)).public(TASK, mixed.split(TASK))
    assert len(shown) == 204


@pytest.mark.parametrize(
    ("split", "patterns", "words"),
    [
        (None, ["persons", f"{TASK}/ippo-d1-s1"], "has 4 teams, and .* matches none of them"),
        ("validation", ["persons", f"{TASK}/ippo-*"], "validation side of .* has no teams"),
        (None, ["persons", f"{TASK}/sac-*"], f"nearest: {TASK}/ippo"),
        (None, ["persons", "still"], "still are of another kind, so play them in a separate job"),
        (None, ["still", f"{TASK}/ippo-*"], "still are of another kind"),
    ],
)
def test_invalid_company_is_refused(
    mixed: Registry, install_package, split, patterns, words: str
) -> None:
    install_package("assistax_zoo.partners", "still", "tests.zoo.test_partner_kinds:Still")
    kinds.cache_clear()
    try:
        with pytest.raises((ValueError, UnknownIdError), match=words):
            choose_partners(dataclasses.replace(mixed), TASK, split, patterns, 4)
    finally:
        kinds.cache_clear()


def test_robots_are_recorded_with_the_persons_alone(mixed: Registry) -> None:
    """So their training is known after the release got its teams, or more of them."""
    for named in ({"partners": "persons"}, {"split": mixed.split(TASK).id}, {}):
        training = prepare(mixed, TASK, steps=1, **named)
        assert training.split.id == ALONE
    met = made_split_met(mixed, TrainedAgainst(split=ALONE, sha256=alone(mixed).sha256))
    assert met is not None and met.partners == declared_met(mixed, TASK, "persons").partners
    both = mixed.split(TASK)
    with pytest.raises(ValueError, match="has teams, which are not drawn"):
        load_partners(mixed, both, each=True)


def test_robots_train_with_persons_and_teams(mixed: Registry) -> None:
    training, both = prepare(mixed, TASK, steps=1, partners="mixed"), mixed.split(TASK)
    assert training.split == both and training.config.trainer.num_envs % 6 == 0
    assert training.config.partners == (both.id, *(f"{team}/human" for team in LEARNED))
    assert "teams" in training.summary
    met = made_split_met(mixed, TrainedAgainst(split=both.id, sha256=both.sha256))
    assert met is not None and met.partners == training.met.partners
    assert {*both.train} == {*met.partners} and None not in met.partners.values()
    lonely = mixed.split(TASK, ALONE)
    with pytest.raises(ValueError, match="has partners of one kind; choose a split with teams"):
        prepare(mixed, TASK, steps=1, partners="mixed", split=lonely.id)


def locked(registry: Registry, pattern: str, folder: Path, **splits: str) -> Path:
    path = folder / "a.lock"
    write_lock(make_lock(registry, registry.select(pattern), splits), path)
    return path


def test_lock_pins_teams_of_the_test_side(mixed: Registry, tmp_path: Path) -> None:
    whole = read_lock(locked(mixed, f"{TASK}/*", tmp_path))
    assert whole.splits[TASK].id == mixed.split(TASK).id
    here = load_registry(mixed.path)
    grown = put(teams_of([900.0] * 6, len(EARNED)), published(tmp_path).path, "v1")
    assert grown.split(TASK) != here.split(TASK)
    for registry, named in ((here, None), (here, "persons"), (grown, None), (grown, "persons")):
        narrowed = apply_lock(registry, whole, task=TASK, split=named)
        dealt, humans = choose_partners(narrowed, TASK, named, None, 8)
        assert dealt == here.split(TASK) and teams_in(humans) == TESTED
    with pytest.raises(LockError, match="expected the locked one"):
        apply_lock(here, whole, task=TASK, split=ALONE)


def test_lock_of_some_teams_pins_the_persons_alone(mixed: Registry, tmp_path: Path) -> None:
    some = read_lock(locked(mixed, f"{TASK}/ippo-d1-s[02]", tmp_path))
    assert some.splits[TASK].id == ALONE
    for named in (None, "persons"):
        narrowed = apply_lock(mixed, some, task=TASK, split=named)
        dealt, humans = choose_partners(narrowed, TASK, named, None, 4)
        assert dealt.id == ALONE and teams_in(humans) == []
    with pytest.raises(LockError, match="lock all partners of the task"):
        locked(mixed, f"{TASK}/ippo-d1-s[02]", tmp_path, **{TASK: "persons"})


def test_list_marks_the_split_with_teams(
    mixed: Registry, capsys: pytest.CaptureFixture[str]
) -> None:
    list_splits(task=TASK, registry=mixed.path)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [ALONE, "14400", "1600", "14000"] in lines
    assert [mixed.split(TASK).id, "14403", "1600", "14004", "yes"] in lines


def test_simulations_seat_partners_of_one_kind(mixed: Registry) -> None:
    how: dict[str, Any] = {"num_envs": 2, "backend": "native", "zoo": mixed.path}
    env = vector_env(TASK, partners=f"{TASK}/ippo-d1-s[36]", **how)
    env.reset(seed=0)
    assert {*env.partner_names()} == {f"{team}/human" for team in LEARNED[1:]}
    with pytest.raises(ValueError, match="persons and teams are named; name partners of one kind"):
        vector_env(TASK, partners=[f"{TASK}/person-0000*", LEARNED[0]], **how)
    with pytest.raises(SplitError, match="one of its test side"):
        vector_env(TASK, partners=TESTED[0], **how)
