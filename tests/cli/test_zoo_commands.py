import json
from pathlib import Path

import numpy as np
import pytest

from assistax_zoo.shell.main import run
from evaluation.record import manifest
from population.networks.stack import flatten
from population.networks.tensors import encode
from tests.zoo.conftest import SPECS, put, random_params, trained_team

FIRST = "scratch/ippo-d1-s0-v0"
CREATE = "split create --task scratch"


def write_run(folder: Path, disabilities=("d1", "d9"), seeds=4) -> Path:
    """Write a run folder with random teams, as a trainer does."""
    folder.mkdir()
    names = [(disability, seed) for disability in disabilities for seed in range(seeds)]
    for place, (role, spec) in enumerate(SPECS.items()):
        first = 1000 * len(names) + 100 * place  # runs of other sizes have other parameters
        rows = [flatten(random_params(spec, first + row)) for row in range(len(names))]
        leaves = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        data = encode(leaves, {"spec": spec.to_json(), "rows": [f"{d}-{s}" for d, s in names]})
        (folder / f"{role}.safetensors").write_bytes(data)
    known = {"task": "scratch", "algorithm": "ippo"}
    figures = {"mean": 900.0, "iqm": 910.0, "mean_ci": [890.0, 915.0], "n": 8}
    teams = [
        {
            "team": {**known, "disability": disability, "seed": seed},
            "roles": {
                role: {"spec": spec.to_json(), "file": f"{role}.safetensors", "row": row}
                for role, spec in SPECS.items()
            },
            "training": {"steps": 1000, "env_version": 1, "backend": "native"},
            "self_play": figures if seed else None,
        }
        for row, (disability, seed) in enumerate(names)
    ]
    (folder / "teams.json").write_text(json.dumps(teams))
    return folder


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
    assert f"{FIRST}/human" in refusal(capsys, "list", "scratch/ipo-d1-s0-v0/human")
    assert "scratch" in refusal(capsys, "list", "--task", "scrach")


def test_self_play_is_of_teams_alone(capsys) -> None:
    alone = "a robot alone has no self-play; `assistax-zoo evaluate NAME` measures its M_test"
    assert run(["list", "gentle_scratch/dagger-ego-*"]) == 0
    ids = [f"gentle_scratch/dagger-ego-s{seed}-v1/robot" for seed in range(3)]
    assert capsys.readouterr().out.splitlines() == ["policy", *ids, f"3 policies; {alone}"]
    assert run(["list", "gentle_scratch/person-0000[01]"]) == 0
    persons = [f"gentle_scratch/person-0000{number}-v1/human" for number in range(2)]
    assert capsys.readouterr().out.splitlines() == ["policy", *persons, "2 policies"]
    assert run(["list", "scratch/*-s0-v1/robot"]) == 0
    lines = capsys.readouterr().out.splitlines()
    [robot] = [line.split() for line in lines if "-ego-" in line]
    assert robot == ["scratch/ppo-ego-s0-v1/robot", "-"] and lines[-1].endswith(alone)
    assert "self-play" in lines[0] and "not measured" not in "".join(lines)
    assert run(["show", "gentle_scratch/dagger-ego-s0"]) == 0
    assert f"self_play            {alone}" in capsys.readouterr().out
    assert run(["show", "gentle_scratch/person-00004"]) == 0


def test_show(zoo: Path, capsys) -> None:
    card = answer(capsys, "show", f"{FIRST}/human")
    assert card["spec"] == SPECS["human"].to_json() and card["training"]["steps"] == 1000
    assert card["training"]["run"] == "run" and card["disability"]["strength"] == 1.0
    assert next(iter(card["splits"].values())) in ("train", "test")
    cards = answer(capsys, "show", FIRST)
    assert [card["id"] for card in cards] == [f"{FIRST}/robot", f"{FIRST}/human"]
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
    printed = {}
    for words in ((), ("--json",)):
        with pytest.raises(SystemExit, match="1"):
            run(["verify", str(tmp_path), *words])
        printed[words] = capsys.readouterr().out
    assert len(printed[()]) < 10_000 and "10000 problems in" in printed[()]
    assert "and 9980 more problems; --json prints all" in printed[()]
    assert len(json.loads(printed["--json",])["problems"]) == 10_000


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
    create = ("split", "create", "--task", "scratch", "--rule")
    made = answer(capsys, *create, "leave-one-disability-out", "--held-out", "d9")
    assert made["held_out"] == "d9" and answer(capsys, "split", "show", made["id"]) == made
    sides = ("--train", "scratch/*-s[01]-*", "--test", "scratch/*-s2-*")
    custom = answer(capsys, *create, "custom", *sides)
    assert len(custom["train"]) == 4 and len(custom["test"]) == 2
    names = sorted([default["id"], made["id"], custom["id"]])
    verified = answer(capsys, "split", "verify")
    assert verified == {"ok": True, "splits": names, "problems": {}}
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
    for words, message in (
        ("scratch --rule custom --train * --test *-s0-*", "on both"),
        ("scratch --rule leave-one-disability-out", "d1, d9"),
        ("bed_bath", "no partners"),
    ):
        assert message in refusal(capsys, "split", "create", "--task", *words.split())
    assert "split create" in refusal(capsys, "split", "show", "scratch/half-s7")
    data = json.loads(zoo.read_text())
    data["splits"][0]["test"].pop()
    zoo.write_text(json.dumps(data))
    with pytest.raises(SystemExit, match="1"):
        run(["split", "verify"])
    assert "expected sha256" in capsys.readouterr().out
    assert "expected releases with the roots" in refusal(capsys, "split", "show", "scratch")


@pytest.mark.parametrize("words", ["list", f"show {FIRST}", "verify", "split list", CREATE])
def test_absent_registry_gets_one_line(words: str, tmp_path: Path, capsys) -> None:
    absent = ("--registry", str(tmp_path / "none.json"))
    assert "no such file" in refusal(capsys, *words.split(), *absent)
