import json
import re

import pytest

from assistax_envs.disability import DISABILITY_SETTINGS
from assistax_zoo.commands.train_ego import load_partners, shared_out
from assistax_zoo.main import run
from population.config import preset
from zoo import storage
from zoo.registry import load_registry

TINY = [
    "--num-envs",
    "16",
    "--set",
    "rollout_steps=4",
    "--set",
    "minibatches=2",
    "--set",
    "hidden=(8, 8)",
]


def unreadable(test, loaded):
    """Return a `_verified_row` that notes what is taken from shards and cannot take a row of the test half."""
    take = storage._verified_row

    def row(*place):
        entry = place[-1]
        if entry.id.rpartition("/")[0] in test:
            raise OSError(f"the row of {entry.id} is unreadable")
        loaded.append(entry.id)
        return take(*place)

    return row


def test_only_the_training_half_is_loaded(monkeypatch):
    registry = load_registry()
    split, loaded = registry.split("scratch", "half"), []
    monkeypatch.setattr(storage, "_verified_row", unreadable(split.test, loaded))
    partners = load_partners(registry, split)
    assert sorted(partners.names) == sorted(loaded) == [f"{team}/human" for team in split.train]
    assert list(partners.disabilities) == [
        DISABILITY_SETTINGS[name.split("/")[1].split("-")[1]] for name in partners.names
    ]
    with pytest.raises(
        OSError, match="is unreadable"
    ):  # the guard bites: other halves would be seen
        load_partners(registry, split.model_copy(update={"train": split.test}))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--algorithm", "ippo"], "algorithm is 'ippo'; allowed are ppo, sac"),
        (
            ["--num-envs", "20", "--set", "minibatches=4"],
            "num_envs is 20 with 99 partners; .* choose 396, or leave",
        ),
        (["--split", "halves"], "expected one split"),
        (["--set", "shared=true"], "leave shared out"),
        (["--algorithm", "sac", "--set", "critic=central"], "choose local"),
    ],
)
def test_wrong_values_get_one_line(words, message, tmp_path, capsys):
    assert run(["train-ego", "--task", "scratch", *words, "--out", str(tmp_path / "run")]) == 1
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("algorithm", "partners", "told"),
    [
        (
            "ippo",
            99,
            "99 partners of half, 12 simulations each, 1188 in place of the preset's 1024\n",
        ),
        ("isac", 99, "99 partners of half, 1 simulation each, 99 in place of the preset's 64\n"),
        ("isac", 59, "59 partners of half, 1 simulation each, 59 in place of the preset's 64\n"),
        ("ippo", 16, "16 partners of half, 64 simulations each\n"),
    ],
)
def test_the_preset_is_fitted_to_the_partners_and_says_so(algorithm, partners, told, capsys):
    trainer = shared_out(preset(algorithm), partners, "half", keep=False)
    assert trainer.num_envs % partners == 0 == trainer.num_envs % getattr(trainer, "minibatches", 1)
    assert capsys.readouterr().err == told


@pytest.mark.slow
def test_trained_robots_are_policy_files_that_can_be_evaluated(tmp_path, capfd):
    from evaluation.egos import read_egos

    words = [
        "train-ego",
        "--task",
        "scratch",
        "--split",
        "half-s0-v0",
        "--seeds",
        "2",
        "--steps",
        "128",
        *TINY,
    ]
    assert run([*words, "--out", str(tmp_path / "ego"), "--backend", "native", "--json"]) == 0
    result = json.loads(capfd.readouterr().out)
    assert result["partners"] == 16
    assert [path.rpartition("/")[2] for path in result["policies"]] == [
        "ppo-s0.safetensors",
        "ppo-s1.safetensors",
    ]
    (stack,) = read_egos(result["policies"], load_registry(), "scratch").stacks
    assert len(stack.ids) == 2
    spec, _, metadata = storage.read_policy_file(result["policies"][1])
    assert (spec.role, metadata["seed"], metadata["training"]["steps"]) == ("robot", 1, 128)
    assert metadata["split"].startswith("scratch/half-s0-v0")
    words = [
        "publish",
        str(tmp_path / "ego"),
        "--release",
        "v9",
        "--registry",
        str(tmp_path / "registry.json"),
    ]
    assert run(words) == 0
    published = load_registry(tmp_path / "registry.json")
    ego = published.policy("scratch/ppo-ego-s1-v9/robot")
    assert ego.trained_against is not None and ego.trained_against.split == metadata["split"]
    assert len(published.policies) == 2 and not published.splits  # an ego is never a partner
    (tmp_path / "ego" / "split.json").unlink()
    words[-1] = str(tmp_path / "other.json")
    assert run(words) == 1 and "split.json is missing" in capfd.readouterr().err
