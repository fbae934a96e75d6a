import json
import re

import pytest

from assistax_zoo.shell.main import run
from evaluation.cast.egos import read_egos
from zoo.parameters import storage
from zoo.registry import load_registry

TINY = ["--set", "rollout_steps=4", "--set", "minibatches=2", "--set", "hidden=(8, 8)"]
TINY += ["--num-envs", "16"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--algorithm", "ippo"], "algorithm is 'ippo'; allowed are ppo, sac"),
        (
            ["--num-envs", "20", "--set", "minibatches=4"],
            "num_envs is 20 with 99 partners; .* choose 396, or let it be chosen",
        ),
        (["--split", "halves"], "expected one split"),
        (["--preferences", "p1,p5"], "the humans of scratch have no preferences"),
        (["--set", "shared=true"], "leave shared out"),
        (["--algorithm", "sac", "--set", "critic=central"], "choose local"),
    ],
)
def test_wrong_values_get_one_line(words, message, tmp_path, capsys):
    assert run(["train-ego", "--task", "scratch", *words, "--out", str(tmp_path / "run")]) == 1
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_trained_robots_are_policy_files_that_can_be_evaluated(tmp_path, capfd):
    words = ["train-ego", "--task", "scratch", "--split", "small-5", "--seeds", "2", *TINY[:-2]]
    words += ["--steps", "160", "--num-envs", "20"]
    assert run([*words, "--out", str(tmp_path / "ego"), "--backend", "native", "--json"]) == 0
    result = json.loads(capfd.readouterr().out)
    assert result["partners"] == 5
    names = [path.rpartition("/")[2] for path in result["policies"]]
    assert names == ["ppo-s0.safetensors", "ppo-s1.safetensors"]
    recorded = (tmp_path / "ego" / "run.json").read_bytes()
    command = json.loads(recorded)["command"]
    assert command.startswith("assistax-zoo train-ego --task scratch --split small-5 --seeds 2")
    assert run([*words, "--out", str(tmp_path / "ego"), "--backend", "native"]) == 0
    assert "/policies/*.safetensors'" in capfd.readouterr().out
    assert (tmp_path / "ego" / "run.json").read_bytes() == recorded  # nothing was trained again
    (stack,) = read_egos(result["policies"], load_registry(), "scratch").stacks
    assert len(stack.ids) == 2
    spec, _, metadata = storage.read_policy_file(result["policies"][1])
    assert (spec.role, metadata["seed"], metadata["training"]["steps"]) == ("robot", 1, 160)
    assert metadata["split"].startswith("scratch/small-5-s0-v1")
    assert metadata["met"]["split"]["split"] == metadata["split"]
    split = load_registry().split("scratch", metadata["split"])
    humans = {team: load_registry().policy(f"{team}/human").sha256 for team in split.train}
    assert metadata["met"]["partners"] == humans and not metadata["met"]["own"]
    words = ["publish", str(tmp_path / "ego"), "--release", "v9", "--registry"]
    words.append(str(tmp_path / "registry.json"))
    assert run(words) == 0
    published = load_registry(tmp_path / "registry.json")
    ego = published.policy("scratch/ppo-ego-s1-v9/robot")
    assert ego.trained_against is not None and ego.trained_against.split == metadata["split"]
    assert len(published.policies) == 2 and not published.splits  # an ego is never a partner
    (tmp_path / "ego" / "split.json").unlink()
    words[-1] = str(tmp_path / "other.json")
    assert run(words) == 1 and "split.json is missing" in capfd.readouterr().err


@pytest.mark.slow
def test_told_robots_are_played_alone_where_they_are_told(tmp_path, capfd):
    out, task = tmp_path / "run", ["--task", "gentle_scratch", "--partners", "persons"]
    words = [*TINY, "--algorithm", "liam", "--told", "--steps", "64", "--backend", "native"]
    assert run(["train-ego", *task, *words, "--out", str(out)]) == 0
    file = str(out / "policies" / "liam-s0.safetensors")
    spec, _, metadata = storage.read_policy_file(file)
    assert metadata["told"] is True and spec.observation_size == 54 + 3 and spec.latent == 16
    words = [file, "--persons", "2", "--episodes", "1", "--backend", "native"]
    capfd.readouterr()
    assert run(["evaluate", *task, *words, "--out", str(tmp_path / "refused")]) == 1
    assert "references are not: leave references out" in capfd.readouterr().err
    words += ["--no-references", "--out", str(tmp_path / "played")]
    assert run(["evaluate", *task, *words]) == 0
    summary = json.loads((tmp_path / "played" / "summary.json").read_text())
    assert summary["engine"]["condition"] == "told"


@pytest.mark.slow
def test_a_robot_imitates_told_ones(tmp_path, capfd):
    task = ["--task", "gentle_scratch", "--partners", "persons", "--backend", "native"]
    words = [*TINY, "--algorithm", "gru", "--told", "--steps", "64", "--seeds", "2"]
    assert run(["train-ego", *task, *words, "--out", str(tmp_path / "told")]) == 0
    files = [tmp_path / "told" / "policies" / f"gru-s{seed}.safetensors" for seed in (1, 0)]
    teachers = [word for file in files for word in ("--teacher", str(file))]
    words = ["train-ego", *task, *TINY, "--steps", "64", "--seeds", "3", *teachers]
    assert run([*words, "--out", str(tmp_path / "wrong")]) == 1
    assert "leave the teacher out, or choose dagger" in capfd.readouterr().err
    words += ["--algorithm", "dagger", "--out", str(tmp_path / "run")]
    assert run(words) == 0
    file = tmp_path / "run" / "policies" / "dagger-s2.safetensors"
    spec, _, metadata = storage.read_policy_file(file)
    assert "told" not in metadata and spec.observation_size == 54 and spec.torso == "gru"
    assert run(words) == 0  # nothing is trained again
    words[words.index(str(files[0]))] = str(files[1])
    capfd.readouterr()
    assert run(words) == 1 and "key.teacher" in capfd.readouterr().err
