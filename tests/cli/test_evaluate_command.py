import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_zoo.shell.main import run
from population.networks.spec import PolicySpec
from tests import untrained
from tests.untrained import ROBOT, params_of
from zoo.history.merkle import with_roots
from zoo.parameters.storage import write_policy_file
from zoo.registry import parse_registry
from zoo.saving import dump_registry

STEPS = 20
FIGURE = {"mean", "iqm", "iqm_ci", "n"}


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A registry of eight untrained teams: d1 and d9, four seeds each."""
    return untrained.published(untrained.teams_of(4), tmp_path_factory.mktemp("zoo"))


@pytest.fixture
def registry(published: Path, tmp_path: Path, monkeypatch) -> Path:
    """A copy of the registry to spoil, and episodes of few steps."""
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", STEPS)
    return Path(shutil.copytree(published.parent, tmp_path / "zoo")) / "registry.json"


def call(*words: Any) -> int:
    return run([str(word) for word in words])


def evaluate(registry: Path, *words: Any, policy: Any = "zoo:scratch/ippo-d1-s0-v0/robot") -> int:
    options = {"--task": "scratch", "--episodes": 2, "--backend": "native"}
    defaults = [word for option in options.items() if option[0] not in words for word in option]
    defaults += [] if "--references" in words else ["--no-references"]
    return call("evaluate", "--policy", policy, "--registry", registry, *defaults, *words)


def failure(capfd, code: int) -> str:
    """Return the one line of an error."""
    printed = capfd.readouterr()
    assert code == 1
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert printed.err.count("\n") == 1
    return printed.err


def test_json_is_the_object_of_the_design(registry: Path, capfd):
    assert evaluate(registry, "--json") == 0
    summary = json.loads(capfd.readouterr().out)
    expected = {
        *(
            "task",
            "split",
            "m_test",
            "m_train",
            "gap",
            "by_algorithm",
            "by_disability",
            "worst_partner",
            "episodes",
        ),
        *("nonfinite", "env_steps_per_second", "release", "env_version", "backend"),
    }
    assert expected <= set(summary)
    assert set(summary["m_test"]) >= FIGURE
    assert summary["m_test"]["n"] == 3  # of four, one is the robot's own human
    assert summary["m_train"] is None
    assert summary["episodes"] == 6
    assert list(summary["by_disability"]) == ["d1", "d9"]
    assert (summary["release"], summary["env_version"], summary["backend"]) == ("v0", 1, "native")


@pytest.mark.slow
def test_both_sides_give_the_gap_and_keep_the_tables(registry: Path, tmp_path: Path, capfd):
    assert evaluate(registry, "--split", "both", "--out", tmp_path / "out") == 0
    printed = capfd.readouterr().out
    assert all(
        word in printed
        for word in ("M_test", "M_train - M_test", "d9", "worst partner", str(tmp_path / "out"))
    )
    printed = printed.replace("\n", " ")
    assert (
        "not new to it, left out of the figures, kept in the tables: scratch/ippo-d1-s0" in printed
    )
    table = pl.read_parquet(tmp_path / "out" / "episodes.parquet")
    assert table.height == 16
    assert sorted(table["side"].unique()) == ["test", "train"]
    assert set(table["steps"]) == {STEPS}
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["gap"]["n"] == 7


@pytest.mark.slow
def test_references_and_a_crossplay_put_returns_on_a_scale(
    registry: Path, tmp_path: Path, monkeypatch, capfd
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    words = ["--task", "scratch", "--episodes", 1, "--backend", "native", "--registry", registry]
    for i in (2, 1, 2):
        assert (
            call(
                "crossplay", *words, "--out", tmp_path / "xp", *(["--share", f"{i}/2"] if i else [])
            )
            == 0
        )
    assert call("crossplay", *words, "--out", tmp_path / "xp", "--json") == 0
    capfd.readouterr()
    options = ["--references", "--crossplay", tmp_path / "xp", "--out", tmp_path / "out"]
    assert evaluate(registry, *options, "--json") == 0
    result = json.loads(capfd.readouterr().out)
    assert set(result["references"]) == {
        "zero_action",
        "uniform_random",
        "self_play",
        "best_response",
        "script",
        "passive_human",
        "script_with_passive_human",
    }
    assert [figure["n"] for figure in result["references"].values()] == [3] * 5 + [1] * 2
    assert (
        result["references"]["best_response"]["mean"] >= result["references"]["self_play"]["mean"]
    )
    assert sum(result["relative"]["bounds"]["best"].values()) == 3
    bounds = pl.read_parquet(tmp_path / "out" / "bounds.parquet")
    assert bounds.height == 4
    assert pl.read_parquet(tmp_path / "out" / "references.parquet").height == (4 * 4 + 2) * 2
    # zero, random and the script; self-play; the robot and the script with the passive human
    assert len(list((tmp_path / "cache" / "assistax-zoo" / "references").iterdir())) == 3
    assert json.loads((tmp_path / "out" / "run.json").read_text())["command"].startswith(
        "assistax-zoo evaluate"
    )
    assert evaluate(registry, *options[:3], policy="zoo:scratch/ippo-d9-s0-v0/robot") == 0
    printed = capfd.readouterr()
    assert "zero action" in printed.out
    assert "reference egos" not in printed.err  # played once for all policies


@pytest.mark.slow
def test_robot_of_unknown_code_needs_replace(registry: Path, tmp_path: Path, capfd):
    code, policy = tmp_path / "mine.py", f"python:{tmp_path / 'mine.py'}:make"
    text = "import numpy as np\ndef make():\n    return lambda obs: np.{}((len(obs), 7))\n"
    code.write_text(text.format("zeros"))
    out = ["--out", tmp_path / "out", "--json"]
    assert evaluate(registry, *out, policy=policy) == 0
    first = json.loads(capfd.readouterr().out)
    assert "(reuse)" in failure(capfd, evaluate(registry, *out, policy=policy))
    assert evaluate(registry, *out, "--reuse", policy=policy) == 0
    assert json.loads(capfd.readouterr().out)["m_test"] == first["m_test"]
    code.write_text(text.format("ones"))
    for words in ([], ["--reuse"]):
        refused = failure(capfd, evaluate(registry, *out, *words, policy=policy))
        assert "another job (other egos)" in refused and "(replace)" in refused
    assert evaluate(registry, *out, "--replace", policy=policy) == 0
    assert json.loads(capfd.readouterr().out)["m_test"] != first["m_test"]
    assert call("verify", tmp_path / "out") == 0


def test_a_share_does_not_replace_the_others(tmp_path: Path, capfd):
    words = ["--task", "scratch", "--out", tmp_path, "--share", "1/2", "--replace"]
    assert "parts of the other shares" in failure(capfd, call("crossplay", *words))


@pytest.mark.parametrize("share", ["0/2", "3/2", "1", "a/b"])
def test_a_share_is_one_of_n(registry: Path, tmp_path: Path, share: str, capfd):
    code = call(
        "crossplay",
        "--task",
        "scratch",
        "--registry",
        registry,
        "--out",
        tmp_path / "x",
        "--share",
        share,
    )
    assert "expected i/n with i from 1 to n" in failure(capfd, code)


def test_several_policies_are_seeds_of_one_method(registry: Path, capfd):
    words = [
        "--policy",
        "zoo:scratch/ippo-d1-s1-v0/robot",
        "--partners",
        "scratch/ippo-d9-*",
        "--split",
        "test",
    ]
    assert evaluate(registry, *words, "--json") == 0
    summary = json.loads(capfd.readouterr().out)
    assert len(summary["egos"]) == 2
    assert list(summary["by_disability"]) == ["d9"]
    assert summary["m_test"]["n"] == 2 * summary["partners"]["test"]


@pytest.mark.slow
def test_crossplay_diagonal_is_self_play(registry: Path, tmp_path: Path, capfd):
    """Two teams of each setting; self-play is what `evaluate` gives for a robot's own human."""
    out, teams = tmp_path / "xp", "scratch/ippo-d?-s[01]-v0"
    words = ["--task", "scratch", "--episodes", 2, "--backend", "native", "--registry", registry]
    globs = ["--egos", f"{teams}/robot", "--partners", f"{teams}/human"]
    assert call("crossplay", *words, *globs, "--out", out, "--json") == 0
    summary = json.loads(capfd.readouterr().out)
    assert set(summary["self_play"]) >= FIGURE
    assert (summary["egos"], summary["partners"], summary["episodes"]) == (4, 4, 32)
    for name in (
        "episodes.parquet",
        "pairs.parquet",
        "order.json",
        "summary.json",
        "crossplay.png",
    ):
        assert (out / name).stat().st_size > 0
    pairs = pl.read_parquet(out / "pairs.parquet")
    own = pairs.filter(pl.col("ego_team") == pl.col("partner_team"))
    assert own["return"].mean() == pytest.approx(summary["self_play"]["mean"])
    assert sorted(json.loads((out / "order.json").read_text())["teams"]["order"]) == sorted(
        own["ego_team"]
    )
    team = "scratch/ippo-d9-s1-v0"
    assert (
        evaluate(
            registry,
            *("--partners", f"{team}/human", "--split", "both", "--include-own", "--json"),
            policy=f"zoo:{team}/robot",
        )
        == 0
    )
    alone = json.loads(capfd.readouterr().out)["worst_partner"]["mean"]
    assert own.filter(pl.col("ego_team") == team)["return"].item() == pytest.approx(alone, rel=1e-6)


@pytest.mark.slow
def test_a_finished_crossplay_is_summarised_again_without_running(
    registry: Path, tmp_path: Path, capfd
):
    words = [
        "--task",
        "scratch",
        "--episodes",
        1,
        "--backend",
        "native",
        "--registry",
        registry,
        "--out",
        tmp_path / "x",
    ]
    globs = ["--egos", "scratch/ippo-d1-s[01]-*", "--partners", "scratch/ippo-d1-s[01]-*"]
    assert call("crossplay", *words, *globs) == 0
    before = (tmp_path / "x" / "episodes.parquet").stat().st_mtime_ns
    assert call("crossplay", *words, *globs) == 0
    assert "found finished" in capfd.readouterr().out
    assert (tmp_path / "x" / "episodes.parquet").stat().st_mtime_ns == before
    assert call("crossplay", *words[:3], 3, *words[4:], *globs) == 1
    assert "holds another job (episodes 1 there, 3 here)" in capfd.readouterr().err


def test_a_robot_in_plain_numpy(registry: Path, tmp_path: Path, monkeypatch, capfd):
    (tmp_path / "numpy_robot_of_a_test.py").write_text(
        "import numpy as np\n"
        "def zero():\n    return lambda obs: np.zeros((len(obs), 7))\n"
        "def wrong():\n    return lambda obs: np.zeros((len(obs), 6))\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert evaluate(registry, "--json", policy="python:numpy_robot_of_a_test:zero") == 0
    assert json.loads(capfd.readouterr().out)["egos"] == ["python:numpy_robot_of_a_test:zero"]
    code = evaluate(registry, policy="python:numpy_robot_of_a_test:wrong")
    message = failure(capfd, code)
    assert "zeros it returned float64 of shape (2, 6); expected floats of shape (2, 7)" in message
    assert "the robot of task scratch reads observations [N, 34] and gives actions" in message


def test_policy_file_of_another_task_is_refused(registry: Path, tmp_path: Path, capfd):
    write_policy_file(tmp_path / "mine.safetensors", ROBOT, params_of(ROBOT, 1))
    assert evaluate(registry, "--json", policy=tmp_path / "mine.safetensors") == 0
    capfd.readouterr()
    other = PolicySpec("robot", observation_size=47, action_size=7, hidden=(8,))
    write_policy_file(tmp_path / "other.safetensors", other, params_of(other, 1))
    message = failure(capfd, evaluate(registry, policy=tmp_path / "other.safetensors"))
    assert (
        "other.safetensors reads observations of 47 numbers; the robot of task scratch has 34"
        in message
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--episodes", "0"], "episodes is 0; each pair needs at least 1"),
        (["--task", "scratchitch"], "task is 'scratchitch'; allowed are scratch"),
        (["--backend", "gpu"], "backend is 'gpu'; allowed are auto,"),
        (["--max-envs", "0"], "max_envs is 0; allowed is 1 or more"),
        (["--seed", "-1"], "seed is -1; allowed is 0 or more"),
        (["--split", "halves"], "split 'halves' is neither a side (test, train, validation, both)"),
        (["--split", "tset"], "nearest: test"),
        (["--split", "both", "--partners", "scratch/ippo-d1-s0-*"], "let include_own count them"),
        (["--split", "half:best"], "after the colon test, train, validation, both are"),
        (["--partners", "scratch/ippo-d1-s77-v0/human"], "nearest: scratch/ippo-d1-"),
        (["--policy", "zoo:scratch/ippo-d1-s00-v0/robot"], "nearest: scratch/ippo-d1-s0-v0/robot"),
        (["--policy", "zoo:scratch/ippo-d1-s0-v0/robot"], "is given 2 times"),
        (["--policy", "robot"], "unknown form; allowed are an id such as"),
        (["--policy", "robot.py:make"], "did you mean python:robot.py:make?"),
        (["--policy", "bed_bath/ippo-d1-s0-v0/robot"], "is of task bed_bath, not of scratch"),
        (["--policy", "robot.onnx"], "there is no file robot.onnx"),
    ],
)
def test_bad_input_gets_one_clear_line(registry: Path, words: list[str], message: str, capfd):
    assert message in failure(capfd, evaluate(registry, *words))


def test_corrupted_shard_names_both_hashes(registry: Path, capfd):
    shard = next((registry.parent / "zoo").rglob("*human*.safetensors"))
    data = bytearray(shard.read_bytes())
    expected = json.loads(registry.read_text())["shards"][
        shard.relative_to(registry.parent).as_posix()
    ]["sha256"]
    data[-5] ^= 1
    shard.chmod(0o644)
    shard.write_bytes(bytes(data))
    message = failure(capfd, evaluate(registry))
    assert expected in message
    assert shard.name in message


def test_a_release_of_another_environment_version_is_refused(registry: Path, capfd):
    text = registry.read_text()
    changed = text.replace('"environments": {"scratch": 1}', '"environments": {"scratch": 2}')
    assert changed != text
    registry.write_text(dump_registry(with_roots(parse_registry(changed, "edited"))))
    message = failure(capfd, evaluate(registry))
    assert "expected version 1 of environment scratch" in message
    assert "release v0, trained on version 2" in message


def test_unwritable_output_folder_is_refused_first(registry: Path, tmp_path: Path, capfd):
    (tmp_path / "file").write_text("in the way")
    message = failure(
        capfd,
        evaluate(registry, "--out", tmp_path / "file" / "out", policy="python:never_imported:f"),
    )
    assert "cannot write to" in message
    assert "choose another folder" in message


def test_a_missing_task_is_wrong_usage(capfd):
    assert call("evaluate", "--policy", "zoo:x") == 2
    assert "--task" in capfd.readouterr().err


@pytest.mark.slow
def test_standard_output_of_a_process_is_one_json_object(published: Path, tmp_path: Path):
    """Whatever libraries print, when imported or from C, is not in it."""
    code = (
        "import assistax_envs.env, sys\n"
        f"assistax_envs.env.EPISODE_LENGTH = {STEPS}\n"
        "from assistax_zoo.shell.main import run\n"
        "sys.exit(run(sys.argv[1:]))\n"
    )
    words = [
        "evaluate",
        "--task",
        "scratch",
        "--policy",
        "zoo:scratch/ippo-d9-s2-v0/robot",
        "--episodes",
        "1",
    ]
    words += ["--registry", str(published), "--backend", "native", "--json"]
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout)["episodes"] == 3


@pytest.mark.slow
@pytest.mark.parametrize(("platform", "backend"), [("tpu", "native"), ("cuda", "auto")])
def test_missing_devices_get_one_line(
    published: Path, tmp_path: Path, platform: str, backend: str
) -> None:
    words = ["evaluate", "--task", "scratch", "--policy", "scratch/ippo-d9-s2-v0/robot"]
    words += ["--registry", str(published), "--backend", backend]
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-m", "assistax_zoo", *words],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(root),
            "JAX_PLATFORMS": platform,
            "CUDA_VISIBLE_DEVICES": "",
        },
        capture_output=True,
        text=True,
    )
    [line] = [line for line in done.stderr.splitlines() if not line.startswith("WARNING")]
    assert done.returncode == 1
    assert line.startswith(f"error: JAX has no device of JAX_PLATFORMS={platform}")
    assert line.endswith("; unset JAX_PLATFORMS to use this machine's devices, or set it to cpu")
