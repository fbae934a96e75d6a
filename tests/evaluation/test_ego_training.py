"""Robots that train with a split's training side."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.ego_training import prepare, shared_out, train_egos
from evaluation.training_partners import load_partners
from population.hyperparameters import preset
from tests.untrained import halved, published, teams_of
from zoo.parameters import storage
from zoo.registry import Registry, load_registry


def test_only_the_training_half_is_loaded(monkeypatch):
    registry = load_registry()
    split, loaded = registry.split("scratch", "half"), []
    take = storage._verified_row  # every way to the parameters passes here

    def row(*place):
        entry = place[-1]
        if entry.id.rpartition("/")[0] in split.test:
            raise OSError(f"the row of {entry.id} is unreadable")
        loaded.append(entry.id)
        return take(*place)

    monkeypatch.setattr(storage, "_verified_row", row)
    partners = load_partners(registry, split)
    assert sorted(partners.ids) == sorted(loaded) == [f"{team}/human" for team in split.train]
    assert partners.settings(len(partners)) == [
        DISABILITY_SETTINGS[name.split("/")[1].split("-")[1]] for name in partners.ids
    ]
    # The guard would notice rows of other halves.
    with pytest.raises(OSError, match="is unreadable"):
        load_partners(registry, split.model_copy(update={"train": split.test}))


@pytest.mark.parametrize(
    ("algorithm", "partners", "share", "envs"),
    [("ippo", 99, 12, 1188), ("isac", 99, 1, 99), ("isac", 59, 1, 59), ("ippo", 16, 64, 1024)],
)
def test_the_preset_is_fitted_to_the_partners(algorithm, partners, share, envs):
    trainer = shared_out(preset(algorithm), partners, keep=False)
    assert (trainer.num_envs, trainer.num_envs // partners) == (envs, share)
    assert trainer.num_envs % getattr(trainer, "minibatches", 1) == 0


def test_preparation_reports_shared_simulations():
    training = prepare(load_registry(), "scratch", split="small-5", seeds=[3, 5], steps=1000)
    assert [member.seed for member in training.config.members] == [3, 5]
    assert training.config.partners == training.partners.ids
    assert training.config.self_play_episodes == 0
    assert "204 simulations each, 1020 in place of the preset's 1024" in training.summary


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "ippo"}, "algorithm is 'ippo'; allowed are ppo, sac"),
        ({"task": "swim"}, "task is 'swim'"),
        ({"preferences": ["p1"]}, "the humans of scratch have no preferences"),
        ({"split": "small-5", "hyperparameters": {"num_envs": 24}}, "with 5 .* choose 20"),
    ],
)
def test_unfit_training_settings_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        prepare(load_registry(), **{"task": "scratch", **changes})


@pytest.fixture(scope="module")
def registries(tmp_path_factory: pytest.TempPathFactory) -> tuple[Registry, Registry]:
    """Two of equal ids: the other's parameters are halved."""
    home, teams = tmp_path_factory.mktemp("zoos"), teams_of(2)
    mine = load_registry(published(teams, home / "mine"))
    return mine, load_registry(published(halved(teams), home / "other"))


TINY: dict[str, Any] = {
    "seeds": 1,
    "steps": 1,
    "hyperparameters": {"rollout_steps": 2, "minibatches": 1, "hidden": (8, 8)},
}


def test_partners_of_equal_ids_have_another_key(registries: tuple[Registry, Registry]) -> None:
    mine, other = (prepare(registry, "scratch", **TINY) for registry in registries)
    assert dataclasses.replace(mine.config, key=other.config.key) == other.config
    assert mine.config.key["partners"] != other.config.key["partners"]
    assert mine.config == prepare(registries[0], "scratch", **TINY).config
    persons = prepare(load_registry(), "gentle_scratch", partners="persons", **TINY)
    assert set(persons.config.key) == {"split", "partners"}


@pytest.mark.slow
def test_a_finished_run_keeps_its_claims(
    registries: tuple[Registry, Registry], tmp_path: Path
) -> None:
    """Asked again under another registry it would claim partners that it never met."""
    mine, other = (prepare(registry, "scratch", **TINY) for registry in registries)
    trained = train_egos(mine, tmp_path / "run", backend="native")
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert config["environment"]["scene"] and config["environment"]["engine"]["name"] == "native"
    with pytest.raises(ValueError, match="its partners have other parameters or settings"):
        train_egos(other, tmp_path / "run", backend="native")
    assert train_egos(mine, tmp_path / "run", backend="native").files == trained.files
    after = {path: path.read_bytes() for path in before}
    assert after == before
