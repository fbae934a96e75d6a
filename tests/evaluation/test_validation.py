"""Checkpoints and seeds are chosen by the validation side, and by nothing else."""

import json
from pathlib import Path

import polars as pl
import pytest

from assistax_zoo.shell.main import run
from evaluation.ego_training import prepare
from evaluation.record.record import Record
from evaluation.validation import CHOICES, CURVE, validation_side
from tests import untrained
from zoo.parameters.storage import read_policy_file
from zoo.registry import load_registry
from zoo.splitting.create import create_split

TINY = ["--num-envs", "12", "--set", "rollout_steps=4", "--set", "minibatches=1"]
TINY += ["--set", "hidden=(8, 8)", "--set", "learning_rate=0.1"]


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty untrained teams, and a split of three sides: 12, 3 and 5."""
    path = untrained.published(untrained.teams_of(10), tmp_path_factory.mktemp("zoo"))
    with pytest.MonkeyPatch.context() as patch:  # humans that nobody trained act alike
        patch.setattr("zoo.splitting.create.similar_pairs", lambda registry, split: [])
        create_split(path, task="scratch", rule="three-sides", default=True)
    return path


def test_split_without_validation_is_refused_early(tmp_path: Path, capsys) -> None:
    words = ["train-ego", "--task", "scratch", "--split", "half", "--validate", "2"]
    assert run([*words, "--out", str(tmp_path / "run")]) == 1
    assert "has no validation side, by which checkpoints" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_persons_have_a_validation_side() -> None:
    registry = load_registry()
    with pytest.raises(ValueError, match="no validation side"):
        validation_side(registry, registry.split("scratch", "half"))
    persons = registry.split("gentle_scratch", "persons")
    assert validation_side(registry, persons) == f"{persons.id}:validation"


@pytest.mark.slow
def test_choices_are_those_of_the_validation_side(
    registry: Path, tmp_path: Path, capfd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 20)
    out = tmp_path / "run"
    words = ["train-ego", "--task", "scratch", "--seeds", "4", "--steps", "288", *TINY]
    words += ["--validate", "3", "--best-of", "2", "--backend", "native", "--json"]
    assert run([*words, "--registry", str(registry), "--out", str(out)]) == 0
    printed = capfd.readouterr()
    answer = json.loads(printed.out)["choices"]
    # Counters begin anew in the second.
    assert "\nstage 1 of 2, training of scratch ppo: " in printed.err
    assert "\nstage 2 of 2, validation of scratch, robots with humans: compiling, " in printed.err
    split = prepare(load_registry(registry), "scratch", steps=288).split
    played = Record.read(out / "validation").returns
    assert set(played.partners["partner_team"]) == set(split.validation)
    curve = pl.read_parquet(out / CURVE)
    assert curve["steps"].unique().sort().to_list() == [96, 192, 288]
    assert curve.height == 12 and curve["return"].n_unique() > 4  # they differ
    scores = dict(zip(played.egos["ego"], played.scores.mean(axis=1), strict=True))
    for choice in answer["by_seed"]:
        own = curve.filter(seed=choice["seed"]).sort("return", descending=True)
        assert (choice["steps"], choice["mean"]) == (own["steps"][0], own["return"][0])
        _, params, about = read_policy_file(out / choice["file"])
        assert about["training"]["steps"] == choice["steps"] and about["seed"] == choice["seed"]
        named = [name for name in scores if name.endswith(f"-s{choice['seed']}.safetensors")]
        steps = {read_policy_file(name)[2]["training"]["steps"]: name for name in named}
        kept = steps[choice["steps"]]
        assert str(read_policy_file(kept)[1]) == str(params)
    means = [choice["mean"] for choice in answer["by_seed"]]
    assert [choice["mean"] for choice in answer["best"]] == [max(means[:2]), max(means[2:])]
    assert all((out / choice["file"]).is_file() for choice in answer["best"])
    assert json.loads((out / CHOICES).read_text()) == answer
    assert run([*words, "--registry", str(registry), "--out", str(out)]) == 0  # goes on: the same
    assert json.loads(capfd.readouterr().out)["choices"] == answer
