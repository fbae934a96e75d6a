"""Evaluations, cross-plays and trainings with persons in place of networks."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_base.errors import RegistryVersionError, SplitError, UnknownIdError
from assistax_envs import Disability, make
from assistax_envs.persons import numbers, person, person_params, persons
from assistax_envs.persons.rows import FAMILIES, ROWS, index
from assistax_envs.versions import VERSIONS
from assistax_workshop.press.publish import publish
from assistax_zoo import cross_play, evaluate
from evaluation.cast.cast import choose_partners
from evaluation.cast.partners import zoo_partner
from evaluation.cast.roster import registry_roster
from evaluation.cast.seats import version_of
from evaluation.crossplay import cast_population
from evaluation.ego_training import prepare
from evaluation.film import Pair
from evaluation.play.how import PlaySettings
from evaluation.play.runner import Runner
from evaluation.play.study import make_job
from evaluation.play.tiles import plan
from evaluation.replay.replay import replay_folder
from tests.untrained import gentle_specs, params_of, published, teams_of
from zoo.met.claims import claimed_met, claimed_version, declared_met, side_met
from zoo.parameters.storage import write_policy_file
from zoo.registry import Registry, load_registry

TASK = "gentle_scratch"
EGO = load_registry().of_task(TASK, "robot")[0].id
HUMAN = f"{TASK}/ippo-d1-s0-v0/human"  # of untrained teams


@pytest.mark.parametrize(
    ("split", "patterns", "of"),
    [
        (None, "persons", ("test",)),
        ("persons", None, ("test",)),
        ("persons:validation", None, ("validation",)),
        ("validation", ["persons"], ("validation",)),
        ("train", "persons", ("training",)),
        ("both", "persons", ("training", "test")),
        (None, "gentle_scratch/person-08*-v1", ("test",)),
    ],
)
def test_a_user_says_of_which_side(split, patterns, of) -> None:
    registry = load_registry()
    chosen, humans = choose_partners(registry, TASK, split, patterns)
    assert len(humans) == 200
    assert {person(TASK, entry.row).side for entry in humans} == set(of)
    assert chosen.rule == "persons"


@pytest.mark.parametrize(
    ("split", "of"), [(None, "test"), ("validation", "validation"), ("train", "training")]
)
def test_task_without_teams_defaults_to_persons(split: str | None, of: str) -> None:
    registry = load_registry()
    chosen, humans = choose_partners(registry, TASK, split, None, 20)
    assert chosen == registry.split(TASK, "persons" if of == "test" else chosen.id)
    assert {person(TASK, entry.row).side for entry in humans} == {of} and len(humans) == 20
    cast = cast_population(registry, TASK, f"{TASK}/*", None, persons=20)
    assert cast.split == registry.split(TASK) and len(cast.sides) == 20


def test_fewer_persons_are_a_part_of_more() -> None:
    registry = load_registry()
    some, more = (
        {entry.id for entry in choose_partners(registry, TASK, None, "persons", most)[1]}
        for most in (20, 50)
    )
    assert len(some) == 20 and len(more) == 50 and some < more
    every = choose_partners(registry, TASK, "validation", "persons", len(numbers("validation")))[1]
    assert [entry.row for entry in every] == numbers("validation").tolist()
    with pytest.raises(UnknownIdError, match=r"10000 persons: .* found 1600 that match"):
        choose_partners(registry, TASK, "validation", "persons", 10_000)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ((TASK, None, ["persons", "scratch/ippo-*"]), ValueError, "has no teams; choose teams"),
        (("scratch", None, "scratch/ippo-*", 9), ValueError, "persons is 9"),
        # Each tenth is of validation, which the split of the test side has not.
        ((TASK, None, "gentle_scratch/person-000*9-v1"), UnknownIdError, "validation"),
        (("scratch", None, "persons"), SplitError, "no persons"),
        (("scratch", "half", "persons"), ValueError, "has no persons"),
        ((TASK, "persons-s0-v9", None), SplitError, "persons-s0-v1"),
    ],
)
def test_invalid_choices_are_refused(arguments, error, words) -> None:
    with pytest.raises(error, match=words):
        choose_partners(load_registry(), *arguments)


def networks(folder: Path) -> Registry:
    """Return a registry of untrained teams of the task."""
    path = published(teams_of(1, *gentle_specs(TASK), task=TASK), folder)
    return load_registry(path)


def job_of(rows: tuple[int, ...], **how):
    registry = load_registry()
    ids = [f"gentle_scratch/person-{row:05d}-v1/human" for row in rows]
    robots = registry_roster(registry, [registry.policy(EGO)])
    humans = registry_roster(registry, registry.known(ids))
    return make_job(PlaySettings(TASK, backend="native", **how), robots, humans)


def test_persons_bring_their_bodies_and_wishes() -> None:
    env, job = job_of((3, 8000, 19500))
    assert job.preferences == () and job.episodes == 4
    [chunk] = plan(job, 512)
    _, block, ids = Runner(env, job)._block(chunk.tiles[0])  # private: what the environment gets
    rows = [int(name.split("-")[1]) for name in ids]
    expected = person_params(TASK, persons(TASK)[[row % ROWS for row in rows]])
    np.testing.assert_array_equal(block[2].elbow_range, expected.elbow_range)
    np.testing.assert_array_equal(block[2].preference.force, expected.preference.force)
    [stack] = block[1]  # of all families
    assert len(stack["row"]) == 3


def test_preferences_are_refused() -> None:
    with pytest.raises(ValueError, match="have their own preferences; leave preferences out"):
        job_of((3,), preferences="p1")
    assert job_of((3,), series=3)[1].episodes == 6


@pytest.mark.slow
def test_film_uses_person_body_and_preference() -> None:
    registry = load_registry()
    name = "gentle_scratch/person-00042-v1"
    partner, row = zoo_partner(registry, name), persons(TASK)[[42]]
    np.testing.assert_array_equal(
        partner.humans.preference.force, person_params(TASK, row).preference.force
    )
    assert partner.setting == Disability(1.0, float(row[0][index(TASK)["range"]]), 0.0)
    env = make(TASK, "native")
    pair = Pair(env, "zero", name, lambda: registry, steps=1)
    *_, state = pair.play(lambda: None)
    np.testing.assert_array_equal(state.params.preference.force, partner.humans.preference.force)
    assert np.abs(partner.act(np.zeros(partner.spec.observation_size, np.float32))).max() <= 1.0
    for options in ({"preference": "p1"}, {"disability": "d3"}):
        with pytest.raises(ValueError, match="leave disability and preference out"):
            Pair(env, "zero", name, lambda: registry, **options)


@pytest.mark.slow
def test_a_person_plays_the_same_beside_others() -> None:
    """Whoever plays beside it: values of another shape differ in rounding, which contacts grow."""
    tables = {}
    for rows in ((8000,), (8000, 8001, 8002)):
        env, job = job_of(rows, episodes=2)
        runner = Runner(env, job, length=40)
        parts: list[pl.DataFrame] = []
        runner.run(plan(job, 512), lambda _, played, parts=parts: parts.append(played))
        tables[len(rows)] = pl.concat(parts).filter(pl.col("partner").str.contains("08000"))
    one, three = tables[1], tables[3]
    assert one["key"].to_list() == three["key"].to_list()
    np.testing.assert_allclose(one["distance_mean"], three["distance_mean"], atol=1e-3)
    assert (one["human_travel"].to_numpy() > 0.0).all()


@pytest.mark.slow
def test_an_evaluation_with_persons_is_replayed(tmp_path: Path) -> None:
    options = {"episodes": 1, "backend": "fused", "progress": False}
    # An untrained robot of the published one's sizes.
    spec = load_registry().policy(EGO).spec
    robot = tmp_path / "robot.safetensors"
    write_policy_file(robot, spec, params_of(spec, 0), {"task": TASK})
    out = tmp_path / "out"
    result = evaluate(
        str(robot), task=TASK, partners="persons", persons=6, references=False, out=out, **options
    )
    assert result.episodes.height == 6 and "preference" not in result.episodes.columns
    assert set(result.episodes["side"]) == {"test"}
    assert set(result.episodes["partner_algorithm"]) <= {*FAMILIES}
    shutil.copy(robot, out)  # a replay reads no robot's file elsewhere
    report = replay_folder(out, load_registry(), sample=2, seed=0)
    assert report.ok and report.exact, report.problems


def test_older_teams_do_not_meet_persons(tmp_path: Path) -> None:
    before, path = VERSIONS[TASK] - 1, tmp_path / "registry.json"
    teams = teams_of(1, *gentle_specs(TASK), task=TASK)
    older = [dataclasses.replace(t, training={**t.training, "env_version": before}) for t in teams]
    publish(older, path, "v0", environments={TASK: before})
    publish([], path, "v1", persons=[TASK])
    robot, out = HUMAN.replace("human", "robot"), tmp_path / "out"
    with pytest.raises(RegistryVersionError, match=f"of environment {TASK}"):
        cross_play([robot], "persons", task=TASK, persons=3, out=out, zoo=path)


def _robot_file(path: Path, version: Any) -> str:
    spec = load_registry().policy(EGO).spec
    write_policy_file(path, spec, params_of(spec, 0), {"task": TASK, "training": version})
    return str(path)


def test_robot_file_has_environment_version(tmp_path: Path) -> None:
    older = _robot_file(tmp_path / "older.safetensors", {"env_version": 2})
    with pytest.raises(RegistryVersionError, match="says that it was trained in version 2"):
        evaluate(older, task=TASK, partners="persons", persons=3, progress=False)
    now = VERSIONS[TASK]
    newer = _robot_file(tmp_path / "newer.safetensors", {"env_version": now})
    both = (load_registry(), "person-00042-v1"), (networks(tmp_path), "ippo-d1-s0-v0")
    for registry, name in both:
        human, words = f"zoo:{TASK}/{name}/human", f"version {now} of environment {TASK}, whi"
        with pytest.raises(RegistryVersionError, match=words):
            version_of({"robot": older, "human": human}, TASK, lambda registry=registry: registry)
        seats = {"robot": newer, "human": human}
        assert version_of(seats, TASK, lambda registry=registry: registry) == now
    registry = load_registry()
    ancient = _robot_file(tmp_path / "ancient.safetensors", {"env_version": 1})
    with pytest.raises(RegistryVersionError, match="as installed"):
        version_of({"robot": ancient}, TASK, lambda: registry)


@pytest.mark.parametrize("claim", [None, "3", True, -1, 3.0, {"env_version": "3"}, 10**12])
def test_malformed_claim_is_ignored(claim: Any) -> None:
    assert claimed_version({"env_version": claim, "training": claim}) is None


def test_person_trained_robot_records_partners() -> None:
    registry = load_registry()
    training = prepare(registry, TASK, partners="persons", steps=1)
    assert training.config.partners == (training.split.id,)
    assert training.summary.startswith("a new person each episode, of the 14400 of gentle_scratch/")
    claim = training.met.claim
    assert set(claim["met"]) == {"own", "split"}  # fourteen thousand names stand in no file
    met = claimed_met(registry, claim)
    assert met == side_met(registry, training.split).model_copy(update={"source": "file"})
    assert met.partners["gentle_scratch/person-00042-v1"] == person(TASK, 42).identity
    assert "gentle_scratch/person-00049-v1" not in met.partners
    assert declared_met(registry, TASK, "persons").partners == met.partners
    other = {"met": {"split": {**claim["met"]["split"], "sha256": "0" * 64}}}
    assert not claimed_met(registry, other).known


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"partners": "people"}, "allowed are persons"),
        ({"partners": "persons", "preferences": ["p1"]}, "leave preferences out"),
        ({"task": "scratch", "partners": "persons", "split": "half"}, "half-s0-v1-524fe016 has no"),
    ],
)
def test_invalid_training_is_refused(changes, words) -> None:
    with pytest.raises((ValueError, SplitError), match=words):
        prepare(load_registry(), **{"task": TASK, "steps": 1, **changes})
