"""Persons and teams of a task in one job: whose wishes are drawn, and which groups count."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_base.digest import json_sha256
from assistax_envs.disability import Disability
from assistax_envs.persons import person_params, persons
from assistax_envs.persons.rows import marked
from assistax_envs.persons.senses import SEAT_SIZES
from assistax_envs.preferences import PREFERENCES
from assistax_workshop.press.publish import publish
from assistax_zoo import cross_play, evaluate
from evaluation.cast.cast import choose_partners, groups_beside_teams, leaves_the_choice
from evaluation.cast.roster import Member, Roster, joined
from evaluation.evaluate import cast_robots
from evaluation.figures.comparable import Evaluated, comparable, summarise_comparison
from evaluation.play.baselines import reference_roster
from evaluation.play.how import PlaySettings
from evaluation.play.jobs import Job
from evaluation.play.rows import planned_rows
from evaluation.play.runner import Runner
from evaluation.play.study import make_job
from evaluation.play.tiles import cut_tiles, plan
from evaluation.replay.replay import replay_folder
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack, stack_policies
from population.views import View
from tests.untrained import gentle_specs, params_of, teams_of
from zoo.parameters.storage import write_policy_file
from zoo.partners.person_ids import is_team
from zoo.partners.person_seat import PersonSpec
from zoo.partners.person_tables import persons_alone
from zoo.registry import Registry, load_registry

TASK, OWN = "gentle_scratch", "own"
SOMEBODY = [f"{TASK}/person-{number:05d}-v1/human" for number in (8000, 20042)]
BODY = Disability(1.0, 0.5, 0.0)
# Of the job of `persons_job` before teams could play beside persons, without versions of software.
DIGEST = "6379aa7c2c0bbac588cdb2e5774e1babb10cd167b460ab20f5aacc8a98d24457"


def persons_roster() -> Roster:
    members = {
        name: Member(name, digit * 64, name.removesuffix("/human"), "spring", OWN, 0, BODY)
        for name, digit in zip(SOMEBODY, "ab", strict=True)
    }
    rows = marked(persons(TASK)[[8000, 42]], [0, 2])
    return Roster((PolicyStack(PersonSpec(TASK), tuple(members), {"row": rows}),), members)


def teams_roster() -> Roster:
    spec = PolicySpec("human", *SEAT_SIZES[TASK], hidden=(8,))
    names = [f"{TASK}/ippo-d{k}-s0-v1/human" for k in (1, 9)]
    members = {
        name: Member(name, digit * 64, name.removesuffix("/human"), "ippo", f"d{k}", 0)
        for name, digit, k in zip(names, "cd", (1, 9), strict=True)
    }
    policies = [(name, spec, params_of(spec, k)) for k, name in enumerate(names)]
    return Roster(stack_policies(policies), members)


def job_of(humans: Roster, **how: Any) -> tuple[Any, Job]:
    return make_job(PlaySettings(TASK, backend="native", **how), reference_roster(34, 7), humans)


def mixed_job(**how: Any) -> tuple[Any, Job]:
    return job_of(joined(teams_roster(), persons_roster()), **how)


def test_job_of_persons_alone_keeps_its_digest() -> None:
    sides = dict.fromkeys(SOMEBODY, "test")
    robots = reference_roster(34, 7)
    job = Job(TASK, 4, "native", robots, persons_roster(), 4, sides=sides, own_episodes=True)
    assert json_sha256({**job.identity(), "software": {}}) == DIGEST
    assert len(cut_tiles(job, 512)) == 1


@pytest.mark.parametrize("named", [None, "p1,p5"])
def test_teams_take_turns_and_persons_bring_their_own(named: str | None) -> None:
    _, job = mixed_job(preferences=named)
    _, alone = job_of(teams_roster(), preferences=named)
    assert job.episodes == 4
    assert job.preferences == (tuple(PREFERENCES) if named is None else ("p1", "p5"))
    teams, someone = [*alone.partners.ids], SOMEBODY
    ids = [someone[0], *teams, someone[1]]
    preferences = job.preferences_of(ids, range(4))
    assert preferences[[0, 3]].tolist() == [[OWN] * 4] * 2
    np.testing.assert_array_equal(preferences[1:3], alone.preferences_of(teams, range(4)))
    assert job.digest() != alone.digest()
    with pytest.raises(ValueError, match="persons have their own preferences; leave preferences"):
        job_of(persons_roster(), preferences="p1")


@pytest.mark.parametrize("most", [512, 8])
def test_each_kind_has_tiles_of_its_own(most: int) -> None:
    """For a tile's humans have either drawn preferences or their own."""
    env, job = mixed_job()
    [chunk] = plan(job, 512, most)
    rows = pl.concat(planned_rows(job, tile) for tile in chunk.tiles)
    assert rows.height == job.rows == 2 * 4 * 4
    assert rows.filter(partner_algorithm="spring")["preference"].unique().to_list() == [OWN]
    assert not set(rows.filter(partner_algorithm="ippo")["preference"]) - {*PREFERENCES}
    kinds = {}
    for tile in chunk.tiles:
        _, block, ids = Runner(env, job)._block(tile)  # private: what the environment gets
        kinds[ids[0] in SOMEBODY] = block[2]
        assert len({name in SOMEBODY for name in ids}) == 1
    drawn, own = kinds[False], kinds[True]
    assert drawn.preference is None and np.all(np.asarray(drawn.preference_code) > 0)
    expected = person_params(TASK, persons(TASK)[[8000, 42]]).preference
    assert {*np.asarray(own.preference.force)} <= {*np.asarray(expected.force)}
    assert np.all(np.asarray(own.preference_code) == 0)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    """A release with persons and six untrained teams, one of which is weak."""
    path = tmp_path_factory.mktemp("mixed") / "registry.json"
    teams = [
        dataclasses.replace(
            team, self_play={"mean": mean, "iqm": mean, "mean_ci": [0.0, mean], "n": 8}
        )
        for team, mean in zip(
            teams_of(3, *gentle_specs(TASK), task=TASK),
            (100.0, 20.0, 110.0, 120.0, 140.0, 130.0),
            strict=True,
        )
    ]
    publish(teams, path, "v1", persons=[TASK], date="2027-01-31")
    return load_registry(path)


@pytest.mark.slow
def test_an_evaluation_has_three_groups_and_is_replayed(mixed: Registry, tmp_path: Path) -> None:
    how: dict[str, Any] = {"episodes": 2, "backend": "native", "progress": False}
    how |= {"task": TASK, "persons": 4, "references": False, "zoo": mixed.path}
    robot, out = f"{TASK}/ippo-d1-s1", tmp_path / "whole"
    found = evaluate(robot, out=out, **how)
    played = found.episodes
    assert played.height == 2 * (4 + 2)
    own = played.filter(pl.col("partner_disability") == OWN)
    assert own["preference"].unique().to_list() == [OWN] and own["partner"].n_unique() == 4
    drawn = played.filter(partner_algorithm="ippo")
    assert drawn["preference"].is_in([*PREFERENCES]).all() and drawn["partner"].n_unique() == 2
    liked = {name: preference.force for name, preference in PREFERENCES.items()}
    assert drawn["liked_force"].to_list() == [liked[name] for name in drawn["preference"]]
    assert [*found.by_group] == ["known families", "teams", "unseen family"]
    means = [figure.mean for figure in found.by_group.values()]
    assert found.m_test is not None and found.m_test.mean == pytest.approx(np.mean(means))
    assert OWN not in found.by_preference
    report = replay_folder(out, mixed, sample=2, seed=0)
    assert report.ok, report.problems
    both = dict.fromkeys(("a", "b"), out)
    compared = comparable([Evaluated.read(folder, name) for name, folder in both.items()])
    difference = summarise_comparison(*compared.records).test
    assert difference is not None and difference.means == pytest.approx([found.m_test.mean] * 2)
    for partners, count, groups in (("persons", 4, 2), (f"{TASK}/ippo-*", None, 1)):
        part = evaluate(robot, **{**how, "partners": partners, "persons": count, "episodes": 1})
        assert part.m_test is None and len(part.by_group) == groups


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An untrained robot that is told all numbers of a person."""
    env = View.NUMBERS.make(TASK, "native", numbers=np.zeros((1, 30)))
    sizes = env.observation_size["robot"], env.action_size["robot"]
    spec, path = PolicySpec("robot", *sizes, hidden=(8,)), tmp_path_factory.mktemp("told") / "robot"
    claims = {"task": TASK, **View.NUMBERS.claim}
    write_policy_file(path.with_suffix(".safetensors"), spec, params_of(spec, 0), claims)
    return str(path.with_suffix(".safetensors"))


@pytest.mark.parametrize(
    ("split", "partners", "teams"),
    [
        (None, None, False),
        ("test", None, False),
        ("persons", None, False),
        (None, "persons", False),
        ("its id", None, True),
        (None, ["persons", f"{TASK}/ippo-*"], True),
    ],
)
def test_robots_told_numbers_play_teams_only_if_a_user_asks(
    mixed: Registry, told: str, split: str | None, partners: Any, teams: bool
) -> None:
    whole = mixed.split(TASK)
    named = whole.id if split == "its id" else split
    chosen = choose_partners(mixed, TASK, named, partners, 4)
    default = leaves_the_choice(named, partners)
    cast = cast_robots(mixed, [told], chosen, default=default)
    assert cast.split == (whole if teams else persons_alone(whole))
    assert {is_team(name) for name in cast.humans.ids} == ({False, True} if teams else {False})
    assert cast.groups == (groups_beside_teams(whole) if teams else ())
    plain = cast_robots(mixed, [f"{TASK}/ippo-d1-s1-v1/robot"], chosen, default=default)
    assert plain.split == whole and plain.humans.ids == tuple(human.id for human in chosen[1])
    if teams:
        with pytest.raises(ValueError, match="only persons have any; play it with persons alone"):
            make_job(PlaySettings(TASK, backend="native"), cast.robots, cast.humans)


@pytest.mark.slow
def test_m_test_of_robots_told_numbers_is_of_persons(mixed: Registry, told: str) -> None:
    how: dict[str, Any] = {"episodes": 1, "backend": "native", "progress": False}
    found = evaluate(told, persons=4, references=False, zoo=mixed.path, task=TASK, **how)
    assert found.m_test is not None and [*found.by_group] == ["known families", "unseen family"]
    assert found.episodes["partner"].n_unique() == 4
    assert any("all numbers of a person, which teams do not have" in note for note in found.notes)


@pytest.mark.slow
def test_a_crossplay_without_names_is_of_the_teams(mixed: Registry, tmp_path: Path) -> None:
    how: dict[str, Any] = {"episodes": 1, "backend": "native", "progress": False}
    found = cross_play(task=TASK, zoo=mixed.path, out=tmp_path, **how)
    assert found.pairs.height == 36
    assert replay_folder(tmp_path, mixed, sample=2, seed=0).ok
