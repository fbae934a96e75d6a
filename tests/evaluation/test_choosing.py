"""Which policies a cross-play takes."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from assistax_base.errors import RegistryVersionError, UnknownIdError
from assistax_envs.versions import VERSIONS
from evaluation import evaluate
from evaluation.cast.cast import choose_partners, env_version, in_release
from evaluation.cast.egos import EgoError
from evaluation.play.how import PlaySettings
from tests.studies import evaluate_policies
from tests.zoo.conftest import put, trained_team, trained_teams
from zoo.registry import Registry, load_registry


@pytest.fixture
def two(tmp_path: Path) -> Registry:
    """A registry of two releases: v0 has IPPO alone, v1 MAPPO too."""
    path = tmp_path / "two" / "registry.json"
    put(trained_teams(), path)
    return put(trained_teams(("ippo", "mappo")), path, "v1")


def test_glob_selects_one_release_by_default(two: Registry) -> None:
    def humans(pattern, release):
        entries = in_release(two, pattern, release, task="scratch", role="human")
        return {entry.release for entry in entries}

    assert humans("scratch/*", "v0") == {"v0"}
    assert humans("scratch/*", "v1") == {"v1"}
    assert humans("scratch/mappo-d1-s0-v1", "v0") == {"v1"}
    assert humans(["scratch/ippo-*/human", "scratch/mappo-*-v1/human"], "v0") == {"v0", "v1"}
    with pytest.raises(UnknownIdError):
        humans("scratch/mappo-*", "v0")


def test_crossplay_includes_egos_only_if_named() -> None:
    def robots(pattern):
        entries = in_release(load_registry(), pattern, "v1", task="scratch", role="robot")
        return {entry.id for entry in entries}

    ego = "scratch/ppo-ego-s0-v1/robot"
    assert len(robots("scratch/*")) == 198 and ego not in robots("scratch/*")
    assert robots("scratch/*-ego-*") == robots(ego) == robots("scratch/ppo-*") == {ego}
    assert robots(["scratch/ippo-d1-s0-v1/robot", ego]) == {"scratch/ippo-d1-s0-v1/robot", ego}


def test_unwritable_cache_error_names_variable(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file")
    settings, kept = PlaySettings("scratch", 1), tmp_path / "cache" / "references"
    with pytest.raises(OSError, match=r"cannot write to .*references .*\$ASSISTAX_ZOO_CACHE"):
        robots = ["zoo:scratch/ippo-d1-s0-v1/robot"]
        evaluate_policies(load_registry(), robots, settings, tmp_path / "out", references=kept)


def test_other_version_error_names_fitting_releases(tmp_path: Path) -> None:
    path = tmp_path / "registry.json"
    teams = [trained_team(seed=seed, task="arm_assist") for seed in range(4)]
    older = [dataclasses.replace(t, training={**t.training, "env_version": 1}) for t in teams]
    put(older, path, environments={"arm_assist": 1})
    registry = put(teams, path, "v1")
    assert env_version(registry, "arm_assist", registry.select("arm_assist/*", release="v1")) == 2
    with pytest.raises(RegistryVersionError, match=r"version 1; .* 2: split arm_assist/"):
        env_version(registry, "arm_assist", registry.select("arm_assist/*", release="v0"))


def test_fitting_releases_exclude_those_without_partners() -> None:
    registry, task = load_registry(), "gentle_feeding"
    releases, now = registry.data.releases, VERSIONS["gentle_feeding"]
    egos = releases["v1"].model_copy(update={"splits": {}, "persons": {}})
    before = egos.model_copy(update={"environments": {task: now - 1}})
    more = {"releases": {**releases, "v5": before, "mine:v0": egos}}
    registry = dataclasses.replace(registry, data=registry.data.model_copy(update=more))
    newer = registry.of_task(task, "robot")[0]
    older = dataclasses.replace(newer, id="older", release="v5")
    with pytest.raises(RegistryVersionError, match=rf"of version {now}: partners persons$"):
        env_version(registry, task, [newer, older])


def test_a_robot_that_cannot_play_is_told_before_anything_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluate, "run_job", lambda *_, **__: pytest.fail("it was played"))
    settings = PlaySettings("scratch", 1, backend="native")
    robots = [lambda obs: obs @ np.zeros((30, 7))]
    with pytest.raises(EgoError, match="task scratch reads observations"):
        evaluate_policies(load_registry(), robots, settings, tmp_path)


def test_partners_bring_the_default_split_of_their_release(two: Registry) -> None:
    newest, test = choose_partners(two, "scratch", None, None)
    assert newest.release == "v1" and {entry.team for entry in test} == set(newest.test)
    older, both = choose_partners(two, "scratch", "both", "scratch/ippo-d1-s?-v0/human")
    assert older == two.split("scratch", release="v0") and len(both) == 4
    # A glob of both releases.
    assert choose_partners(two, "scratch", "train", "scratch/ippo-d1-*")[0] == newest
    words = r"none of the partners that match \(4\) is on the train or test side of .*half-s0-v1"
    with pytest.raises(ValueError, match=words):
        choose_partners(two, "scratch", "half-s0-v1:both", "scratch/ippo-d1-*-v0")


@pytest.mark.parametrize("side", ["test", "train"])
def test_partner_glob_keeps_to_side(side: str) -> None:
    registry = load_registry()
    glob = "scratch/ippo-d1-s?-v1/human"
    split, chosen = choose_partners(registry, "scratch", side, glob)
    assert 0 < len(chosen) < 8
    assert {split.side(entry.team) for entry in chosen} == {side}
    if side == "test":  # which is what is meant where no side is named
        assert choose_partners(registry, "scratch", None, glob) == (split, chosen)
    other = split.train if side == "test" else split.test
    words = rf"none of the partners that match \(1\) is on the {side} side"
    with pytest.raises(ValueError, match=words):
        choose_partners(registry, "scratch", side, f"{other[0]}/human")


@pytest.mark.parametrize("task", ["scratch", "gentle_feeding"])  # with teams, and persons alone
def test_unknown_choice_error_has_nearest_names(task: str) -> None:
    registry = load_registry()
    misspelt = ("tset", "test"), ("half-s0-v1-524fe017", "half-s0"), ("person", "persons")
    for split, near in misspelt:
        words = rf"split '{split}' is neither a side .*nearest: .*{near}"
        with pytest.raises(ValueError, match=words):
            choose_partners(registry, "scratch", split, None)
    for partners, hint in (("person", "persons"), ("persons:test", "split 'persons:test'")):
        words = rf"^partners are '{partners}'; .*; did you mean {hint}\?$"
        with pytest.raises(ValueError, match=words):
            choose_partners(registry, task, None, partners)
