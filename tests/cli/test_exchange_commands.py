"""export, show --card, verify --deep."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from assistax_zoo.shell.main import run
from tests.cli.test_report_command import evaluated
from tests.cli.test_zoo_commands import FIRST, answer, refusal, write_run
from zoo.parameters.storage import read_policy_file
from zoo.splitting.similar_humans import Pair, similar_pairs

ROOT = Path(__file__).parents[2]
TEAM = "scratch/ippo-d1-s0-v1"


def export(name: str, kind: str, out: Path) -> tuple[str, ...]:
    return ("export", name, "--format", kind, "--out", str(out))


def test_the_same_export_again_writes_nothing(zoo: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "robot.safetensors"
    words = export(f"{FIRST}/robot", "safetensors", out)
    assert answer(capsys, *words)["written"] is True
    before = out.stat().st_mtime_ns
    assert answer(capsys, *words)["written"] is False and out.stat().st_mtime_ns == before
    for other in (("human", "safetensors"), ("robot", "torch")):
        assert "--force" in refusal(capsys, *export(f"{FIRST}/{other[0]}", other[1], out))
        assert out.stat().st_mtime_ns == before


def test_export_to_safetensors_and_torch(zoo: Path, tmp_path: Path, capsys) -> None:
    out, torch = tmp_path / "robot.safetensors", tmp_path / "torch.safetensors"
    done = answer(capsys, *export(f"{FIRST}/robot", "safetensors", out))
    read = read_policy_file(out)
    assert done["bytes"] == out.stat().st_size and read.metadata["id"] == f"{FIRST}/robot"
    assert read.params["Dense_0"]["kernel"].shape == (5, 4) and read.metadata["disability"] == "d1"
    assert run([*export(str(out), "torch", torch)]) == 0
    assert run([*export(f"{FIRST}/robot", "torch", out), "--force"]) == 0
    assert out.read_bytes() == torch.read_bytes()  # the file knows its origin
    capsys.readouterr()
    assert f"{FIRST}/robot" in refusal(capsys, *export(FIRST, "torch", tmp_path / "x"))
    refusal(capsys, *export(f"{FIRST}/robot", "pickle", tmp_path / "x"), code=2)


def test_exported_onnx_robot_runs(zoo: Path, tmp_path: Path, capsys) -> None:
    pytest.importorskip("onnx")
    onnxruntime = pytest.importorskip("onnxruntime")
    out = tmp_path / "robot.onnx"
    assert answer(capsys, *export(f"{FIRST}/robot", "onnx", out))["format"] == "onnx"
    session = onnxruntime.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    assert session.run(["action"], {"obs": np.zeros((3, 5), np.float32)})[0].shape == (3, 2)


def test_export_without_onnx_names_the_extra(
    zoo: Path, tmp_path: Path, capsys, monkeypatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    message = refusal(capsys, *export(f"{FIRST}/robot", "onnx", tmp_path / "x"))
    assert "pip install 'assistax-zoo[export]'" in message
    assert not (tmp_path / "x").exists()


def test_a_card_is_written_with_its_picture(zoo: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "robot.png").write_bytes(b"")
    card = tmp_path / "cards" / "README.md"
    card.parent.mkdir()
    image = ("--image", str(tmp_path / "robot.png"))
    assert run(["show", FIRST, "--card", str(card), *image]) == 0
    capsys.readouterr()
    text = card.read_text()
    assert f"![{FIRST}](<../robot.png>)" in text and f"export {FIRST}/human" in text
    absent = ("--image", "none.png")
    assert "no picture at" in refusal(capsys, "show", FIRST, "--card", str(card), *absent)
    assert "--card" in refusal(capsys, "show", FIRST, *image)


def test_card_has_m_test_of_its_robot(zoo: Path, tmp_path: Path, capsys) -> None:
    robot, card = f"{FIRST}/robot", tmp_path / "README.md"
    mine, others = evaluated(tmp_path / "mine", ego=robot), evaluated(tmp_path / "others")
    shown = answer(capsys, "show", robot, "--card", str(card), "--result", str(mine))
    m_test = shown["m_test"]
    assert 400 < m_test["mean_ci"][0] < m_test["mean"] < m_test["mean_ci"][1] < 600
    assert f"with {m_test['n']} partners of the test side of {m_test['split']}" in card.read_text()
    card.unlink()
    said = refusal(capsys, "show", robot, "--card", str(card), "--result", str(others))
    assert f"no M_test of {robot} alone" in said and not card.exists()


def test_robot_is_shared_in_two_commands(tmp_path: Path, capsys) -> None:
    """As docs/publish.md says."""
    mine = tmp_path / "my-zoo"
    words = ["publish", str(write_run(tmp_path / "run")), "--release", "v0", "--to", str(mine)]
    assert run(words) == 0
    registry = ("--registry", str(mine / "registry.json"))
    assert run(["show", FIRST, *registry, "--card", str(mine / "cards" / "first.md")]) == 0
    card = (mine / "cards" / "first.md").read_text()
    assert "assistax-zoo add ADDRESS-OF-THIS-ZOO --as NAME" in card  # its readers do not have it
    assert f"NAME:{FIRST}/robot" in card and f"export NAME:{FIRST}/robot" in card
    capsys.readouterr()
    assert answer(capsys, "verify", *registry)["ok"] is True


def test_only_the_named_seeds_are_published(tmp_path: Path, capsys) -> None:
    run_folder, mine = str(write_run(tmp_path / "run")), ("--to", str(tmp_path / "my-zoo"))
    words = ("publish", run_folder, "--release", "v0", *mine, "--seeds")
    added = answer(capsys, *words, "1,3")["added"]
    assert {name.rpartition("-v0")[0] for name in added} == {
        f"scratch/ippo-{setting}-s{seed}" for setting in ("d1", "d9") for seed in (1, 3)
    }
    assert "seed 7 is not in the runs; allowed are 0, 1, 2, 3" in refusal(capsys, *words, "1,7")


def test_deep_names_policies_that_do_not_fit_the_environment(zoo: Path, capsys) -> None:
    with pytest.raises(SystemExit, match="1"):
        run(["verify", FIRST, "--deep", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is False and report["problems"] == []
    assert "reads observations of 5 numbers" in report["deep"]["problems"][0]
    for words in (["scratch/*"], ["--release", "v0"]):
        assert "add --deep" in refusal(capsys, "verify", *words)


def test_split_verify_reports_partners_that_act_alike(zoo: Path, capsys, monkeypatch) -> None:
    assert answer(capsys, "split", "verify")["problems"] == {}
    monkeypatch.setattr(
        "zoo.splitting.similar_humans.similar_pairs",
        lambda registry, split: similar_pairs(registry, split, 10.0),
    )
    with pytest.raises(SystemExit, match="1"):
        run(["split", "verify"])
    assert "16 nearly alike" in capsys.readouterr().out


def test_split_create_names_the_twins_that_it_leaves_out(zoo: Path, capsys, monkeypatch) -> None:
    twin = Pair("scratch/ippo-d1-s2-v0", "scratch/ippo-d9-s0-v0", 0.01)
    monkeypatch.setattr("zoo.splitting.create.similar_pairs", lambda registry, split: [twin])
    words = "split create --task scratch --rule leave-one-disability-out --held-out d9"
    assert run(words.split()) == 0
    assert f"as a test partner does: {twin.train}\n" in capsys.readouterr().out


def test_looking_at_policies_imports_nothing_heavy(zoo: Path, tmp_path: Path) -> None:
    code = f"""
import sys
from assistax_zoo.shell.main import run
card = ["show", {FIRST!r}, "--card", {str(tmp_path / "c.md")!r}]
for words in (["list"], ["verify"], ["show", {FIRST!r}], ["split", "list"], card):
    assert run(words) == 0
print(sorted({{"jax", "mujoco", "flax", "matplotlib", "polars", "scipy"}} & set(sys.modules)))
"""
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.slow
def test_deep_replays_a_published_team(capsys, monkeypatch) -> None:
    monkeypatch.delenv("ASSISTAX_ZOO_REGISTRY", raising=False)
    assert run(["verify", TEAM, "--deep", "--episodes", "1"]) == 0
    out = capsys.readouterr().out
    assert "mujoco 3." in out and f"ok      {TEAM}" in out
    assert "replayed 1 team of 1 episode on native" in out


@pytest.mark.slow
def test_onnx_robot_earns_its_originals_return(tmp_path: Path, capsys, monkeypatch) -> None:
    pytest.importorskip("onnxruntime")
    monkeypatch.delenv("ASSISTAX_ZOO_REGISTRY", raising=False)
    robot = tmp_path / "robot.onnx"
    assert run([*export(f"{TEAM}/robot", "onnx", robot)]) == 0
    capsys.readouterr()
    words = ("evaluate", "--task", "scratch", "--partners", f"{TEAM}/human", "--episodes", "2")
    means = []
    for name, policy in (("ours", f"zoo:{TEAM}/robot"), ("onnx", f"onnx:{robot}")):
        out = ("--include-own", policy, "--out", str(tmp_path / name))
        figures = answer(capsys, *words, *out)
        means.append((figures["m_train"] or figures["m_test"])["mean"])
    ours, theirs = means
    assert theirs == pytest.approx(ours, rel=0.02)


def test_a_remotes_name_commands_no_terminal(monkeypatch, capfd) -> None:
    monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", "hf://a\x1b]0;owned\x07/b")
    assert run(["config", "remote"]) == 0
    assert capfd.readouterr().out == "hf://a ]0;owned /b\n"
