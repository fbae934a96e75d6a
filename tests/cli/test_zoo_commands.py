import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from assistax_zoo.shell.main import run
from evaluation.record import manifest
from population.networks.spec import PolicySpec
from population.networks.tensors import encode
from tests.zoo.conftest import put, trained_team

ROOT = Path(__file__).parents[2]
SPECS = {
    "robot": PolicySpec("robot", 5, 2, hidden=(4,)),
    "human": PolicySpec("human", 6, 3, hidden=(4,)),
}
FIRST = "scratch/ippo-d1-s0-v0"


def write_run(folder: Path, disabilities=("d1", "d9"), seeds=4) -> Path:
    """Write a run folder with random teams, as a trainer does."""
    folder.mkdir()
    names = [(disability, seed) for disability in disabilities for seed in range(seeds)]
    rng = np.random.default_rng(0)
    for role, spec in SPECS.items():
        sizes = (spec.observation_size, 4, spec.action_size)
        shapes: dict[str, tuple[int, ...]] = {
            f"Dense_{i}/kernel": (sizes[i], sizes[i + 1]) for i in range(2)
        }
        shapes |= {f"Dense_{i}/bias": (sizes[i + 1],) for i in range(2)}
        shapes |= {"log_std": sizes[2:], "normaliser/mean": sizes[:1], "normaliser/std": sizes[:1]}
        leaves = {
            name: rng.random((len(names), *shape), np.float32) for name, shape in shapes.items()
        }
        data = encode(leaves, {"spec": spec.to_json(), "rows": [f"{d}-{s}" for d, s in names]})
        (folder / f"{role}.safetensors").write_bytes(data)
    teams = [
        {
            "team": {
                "task": "scratch",
                "algorithm": "ippo",
                "disability": disability,
                "seed": seed,
            },
            "roles": {
                r: {"spec": s.to_json(), "file": f"{r}.safetensors", "row": row}
                for r, s in SPECS.items()
            },
            "training": {"steps": 1000, "env_version": 1, "backend": "native"},
            "self_play": {"mean": 900.0, "iqm": 910.0, "mean_ci": [890.0, 915.0], "n": 8}
            if seed
            else None,
        }
        for row, (disability, seed) in enumerate(names)
    ]
    (folder / "teams.json").write_text(json.dumps(teams))
    return folder


@pytest.fixture
def zoo(tmp_path: Path, monkeypatch, capsys) -> Path:
    """A published registry, named by the environment variable."""
    path = tmp_path / "zoo" / "registry.json"
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(path))
    assert (
        run(
            ["publish", str(write_run(tmp_path / "run")), "--release", "v0", "--date", "2027-01-31"]
        )
        == 0
    )
    assert "published 16 new policies" in capsys.readouterr().out
    return path


def answer(capsys, *words: str):
    """Run a command with --json and return what it prints."""
    assert run([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refusal(capsys, *words: str, code: int = 1) -> str:
    """Run a command that fails, and return its one line on standard error."""
    assert run(list(words)) == code
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("error: ")
    assert code == 2 or captured.err.count("\n") == 1
    return captured.err


def test_list(zoo: Path, capsys) -> None:
    humans = answer(capsys, "list", "scratch/ippo-*/human", "--disability", "d9")
    assert [row["id"] for row in humans] == [f"scratch/ippo-d9-s{s}-v0/human" for s in range(4)]
    assert humans[0]["self_play"] is None and humans[1]["self_play"]["mean_ci"] == [890.0, 915.0]
    assert run(["list", FIRST]) == 0
    out = capsys.readouterr().out
    assert f"{FIRST}/robot" in out and "not measured" in out and out.endswith("2 policies\n")
    assert run(["list", f"{FIRST}/robot"]) == 0
    assert capsys.readouterr().out.endswith("1 policy\n")


def test_list_names_the_nearest(zoo: Path, capsys) -> None:
    assert f"{FIRST}/human" in refusal(capsys, "list", "scratch/ipo-d1-s0-v0/human")
    assert "scratch" in refusal(capsys, "list", "--task", "scrach")


def test_show(zoo: Path, capsys) -> None:
    card = answer(capsys, "show", f"{FIRST}/human")
    assert card["spec"] == SPECS["human"].to_json() and card["training"]["steps"] == 1000
    assert card["training"]["run"] == "run" and card["disability"]["strength"] == 1.0
    assert next(iter(card["splits"].values())) in ("train", "test")
    assert [card["id"] for card in answer(capsys, "show", FIRST)] == [
        f"{FIRST}/robot",
        f"{FIRST}/human",
    ]
    assert run(["show", FIRST]) == 0
    assert "not measured" in capsys.readouterr().out
    assert f"{FIRST}/human" in refusal(capsys, "show", f"{FIRST}/humen")


def test_verify_passes_then_fails_with_both_hashes(zoo: Path, capsys) -> None:
    assert answer(capsys, "verify")["ok"] is True
    shard = next(zoo.parent.rglob("*-robot-*.safetensors"))
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(SystemExit, match="1"):
        run(["verify"])
    out = capsys.readouterr().out
    assert "expected sha256" in out and "found sha256" in out and "1 problem in" in out
    with pytest.raises(SystemExit):
        run(["verify", "--json"])
    assert json.loads(capsys.readouterr().out)["ok"] is False


@pytest.mark.parametrize("name", ["NOFOLDER", "NOFOLDER/", "registry.json"])
def test_verify_names_a_folder_that_is_absent(name: str, zoo: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(zoo.parent)
    assert f"error: '{name}' " in (line := refusal(capsys, "verify", name))
    assert "is no folder here; name a folder of results, or add --deep" in line


def test_verify_prints_some_of_many_problems(tmp_path: Path, capsys) -> None:
    lost = {f"file-{number}.parquet": "0" * 64 for number in range(10_000)}
    manifest.write_manifest(tmp_path, {"files": lost})
    with pytest.raises(SystemExit, match="1"):
        run(["verify", str(tmp_path)])
    out = capsys.readouterr().out
    assert len(out) < 10_000 and "and 9980 more problems; --json prints all" in out
    assert "10000 problems in" in out
    with pytest.raises(SystemExit):
        run(["verify", str(tmp_path), "--json"])
    assert len(json.loads(capsys.readouterr().out)["problems"]) == 10_000


@pytest.mark.parametrize(
    "words",
    [["list", "x" * 100_000], ["x" * 100_000], ["show", "a/b" * 40_000], ["list", "--x" * 40_000]],
    ids=["glob", "command", "id", "option"],
)
def test_an_error_of_any_length_is_cut(words: list[str], zoo: Path, capsys) -> None:
    assert run(words) in (1, 2)
    assert 10 < len(capsys.readouterr().err) < 10_000


def test_publish_twice_is_a_no_op_and_changed_bytes_are_refused(
    zoo: Path, tmp_path: Path, capsys
) -> None:
    before = zoo.read_bytes()
    assert answer(capsys, "publish", str(tmp_path / "run"), "--release", "v0")["added"] == []
    other = write_run(tmp_path / "other", ("d1",), 1)
    assert "--release v1" in refusal(capsys, "publish", str(other), "--release", "v0")
    assert zoo.read_bytes() == before
    assert "name at least one" in refusal(capsys, "publish", "--release", "v0")
    assert "teams.json" in refusal(capsys, "publish", str(tmp_path / "absent"), "--release", "v0")
    assert "release" in refusal(capsys, "publish", str(other), "--release", "latest")
    refusal(capsys, "publish", str(other), code=2)


def test_splits(zoo: Path, capsys) -> None:
    (default,) = answer(capsys, "split", "list")
    assert default["default"] is True and default["n_train"] == 4
    shown = answer(capsys, "split", "show", "scratch")
    assert shown["id"] == default["id"] and len(shown["test"]) == 4
    made = answer(
        capsys,
        "split",
        "create",
        "--task",
        "scratch",
        "--rule",
        "leave-one-disability-out",
        "--held-out",
        "d9",
    )
    assert made["held_out"] == "d9" and answer(capsys, "split", "show", made["id"]) == made
    sides = ("--train", "scratch/*-s[01]-*", "--test", "scratch/*-s2-*")
    custom = answer(capsys, "split", "create", "--task", "scratch", "--rule", "custom", *sides)
    assert len(custom["train"]) == 4 and len(custom["test"]) == 2
    assert answer(capsys, "split", "verify") == {
        "ok": True,
        "splits": sorted([default["id"], made["id"], custom["id"]]),
        "problems": {},
    }
    assert run(["split", "list", "--task", "scratch"]) == 0
    assert "3 splits" in capsys.readouterr().out
    assert run(["split", "show", "scratch"]) == 0
    assert capsys.readouterr().out.count("scratch/ippo-") == 8


def test_a_split_that_holds_preferences_out_says_so_and_becomes_the_default(
    tmp_path: Path, capsys
) -> None:
    teams = [
        trained_team(name, seed=s, task="gentle_lift") for name in ("ippo", "brdiv") for s in (0, 1)
    ]
    path = str(put(teams, tmp_path / "registry.json", "v2").path)
    words = ("split", "create", "--task", "gentle_lift", "--rule", "leave-one-algorithm-out")
    words += ("--held-out", "brdiv", "--test-preferences", "p1,p5,p9", "--default")
    made = answer(capsys, *words, "--registry", path)
    assert made["id"].startswith("gentle_lift/without-brdiv-p1-p5-p9-s0-v2-")
    assert made["preferences"]["test"] == ["p1", "p5", "p9"]
    assert answer(capsys, "split", "show", "gentle_lift", "--registry", path) == made
    assert run(["split", "show", "gentle_lift", "--registry", path]) == 0
    shown = capsys.readouterr().out
    assert "test, under p1, p5, p9" in shown and "train, under p2, p3, p4, p6, p7, p8" in shown
    assert answer(capsys, "split", "verify", "--registry", path)["ok"]
    message = refusal(capsys, *words, "--train-preferences", "p1", "--registry", path)
    assert "no preference on both sides, found p1" in message


def test_bad_splits_are_refused(zoo: Path, capsys) -> None:
    same = ("--train", "*", "--test", "*-s0-*")
    assert "on both" in refusal(
        capsys, "split", "create", "--task", "scratch", "--rule", "custom", *same
    )
    assert "d1, d9" in refusal(
        capsys, "split", "create", "--task", "scratch", "--rule", "leave-one-disability-out"
    )
    assert "no partners" in refusal(capsys, "split", "create", "--task", "bed_bath")
    assert "split create" in refusal(capsys, "split", "show", "scratch/half-s7")
    data = json.loads(zoo.read_text())
    data["splits"][0]["test"].pop()
    zoo.write_text(json.dumps(data))
    with pytest.raises(SystemExit, match="1"):
        run(["split", "verify"])
    assert "expected sha256" in capsys.readouterr().out
    assert "expected releases with the roots" in refusal(capsys, "split", "show", "scratch")


def test_a_registry_that_is_not_there_gives_one_line(tmp_path: Path, capsys) -> None:
    for command in (
        ["list"],
        ["show", FIRST],
        ["verify"],
        ["split", "list"],
        ["split", "create", "--task", "scratch"],
    ):
        assert "no such file" in refusal(
            capsys, *command, "--registry", str(tmp_path / "none.json")
        )


def test_reading_commands_import_nothing_heavy(zoo: Path) -> None:
    code = (
        "import sys\nfrom assistax_zoo.shell.main import run\n"
        f"for words in (['list'], ['show', '{FIRST}'], ['verify'], ['split', 'list']): assert "
        "run(words) == 0\nprint(sorted({'jax', 'mujoco', 'flax', 'matplotlib', 'polars', 'scipy'} "
        "& set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.splitlines()[-1] == "[]"
