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
SCRATCH = ("--task", "scratch", "--backend", "native")


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
    return call("evaluate", policy, "--registry", registry, *defaults, *words)


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
    expected = "task split m_test m_train gap by_algorithm by_disability worst_partner episodes"
    expected += " nonfinite env_steps_per_second release env_version backend"
    assert {*expected.split()} <= set(summary)
    assert set(summary["m_test"]) >= FIGURE
    assert summary["m_test"]["n"] == 3  # of four, one is the robot's own human
    assert summary["m_train"] is None
    assert summary["episodes"] == 6
    assert list(summary["by_disability"]) == ["d1", "d9"]
    assert (summary["release"], summary["env_version"], summary["backend"]) == ("v0", 1, "native")


@pytest.mark.slow
def test_both_sides_give_the_gap_and_keep_the_tables(registry: Path, tmp_path: Path, capfd):
    assert evaluate(registry, "--all", "--split", "both", "--out", tmp_path / "out") == 0
    printed = capfd.readouterr().out
    words = ("M_test", "M_train - M_test", "d9", "worst partner", str(tmp_path / "out"))
    assert all(word in printed for word in words)
    note = "not new to it, left out of the figures, kept in the tables: scratch/ippo-d1-s0"
    assert note in printed.replace("\n", " ")
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
    crossplay = ["--episodes", 1, "--registry", registry, "--out", tmp_path / "xp"]
    for share in (["--share", "2/2"], ["--share", "1/2"], ["--share", "2/2"], ["--json"]):
        assert call("crossplay", *SCRATCH, *crossplay, *share) == 0
    capfd.readouterr()
    options = ["--references", "--crossplay", tmp_path / "xp", "--out", tmp_path / "out"]
    assert evaluate(registry, *options, "--json") == 0
    printed = capfd.readouterr()
    result, shown = json.loads(printed.out), printed.err
    players = "zero_action uniform_random self_play best_response script passive_human"
    assert set(result["references"]) == {*players.split(), "script_with_passive_human"}
    assert [figure["n"] for figure in result["references"].values()] == [3] * 5 + [1] * 2
    means = {name: figure["mean"] for name, figure in result["references"].items()}
    assert means["best_response"] >= means["self_play"]
    assert sum(result["relative"]["bounds"]["best"].values()) == 3
    assert pl.read_parquet(tmp_path / "out" / "bounds.parquet").height == 4
    assert pl.read_parquet(tmp_path / "out" / "references.parquet").height == (4 * 4 + 2) * 2
    # zero, random and the script; self-play; the robot and the script with the passive human
    assert len(list((tmp_path / "cache" / "assistax-zoo" / "references").iterdir())) == 3
    run_of = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run_of["command"].startswith("assistax-zoo evaluate")
    assert evaluate(registry, "--all", *options[:3], policy="zoo:scratch/ippo-d9-s0-v0/robot") == 0
    printed = capfd.readouterr()
    assert "zero action" in printed.out
    for stage in ("reference robots", "partners with their own robots"):
        assert stage in shown and stage not in printed.err  # played once for all policies
    assert "evaluate scratch, 1 of 4, robots with humans: compiling, " in shown


@pytest.mark.slow
def test_robot_of_unknown_code_needs_replace(registry: Path, tmp_path: Path, capfd):
    code, policy = tmp_path / "mine.py", f"python:{tmp_path / 'mine.py'}:make"
    text = "import numpy as np\ndef make():\n    return lambda obs: np.{}((len(obs), 7))\n"
    code.write_text(text.format("zeros"))
    out = ["--out", tmp_path / "out", "--json"]
    assert evaluate(registry, *out, policy=policy) == 0
    first = json.loads(capfd.readouterr().out)
    refused = failure(capfd, evaluate(registry, *out, policy=policy))
    assert "reuse them, replace them, or choose another folder (--reuse, --replace and" in refused
    assert evaluate(registry, *out, "--reuse", policy=policy) == 0
    assert json.loads(capfd.readouterr().out)["m_test"] == first["m_test"]
    code.write_text(text.format("ones"))
    for words in ([], ["--reuse"]):
        refused = failure(capfd, evaluate(registry, *out, *words, policy=policy))
        assert "another job (other egos)" in refused
        assert "or replace it (--out names another, --replace removes what it holds)" in refused
    assert evaluate(registry, *out, "--replace", policy=policy) == 0
    assert json.loads(capfd.readouterr().out)["m_test"] != first["m_test"]
    assert call("verify", tmp_path / "out") == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        *((["--share", share], "expected i/n with i from 1 to n") for share in ("0/2", "3/2", "a")),
        (["--share", "1/2", "--replace"], "parts of the other shares"),
    ],
)
def test_a_wrong_share_is_refused(registry: Path, tmp_path: Path, words, message: str, capfd):
    out = ["--registry", registry, "--out", tmp_path / "x"]
    assert message in failure(capfd, call("crossplay", *SCRATCH, *out, *words))


def test_several_policies_are_seeds_of_one_method(registry: Path, capfd):
    words = ["zoo:scratch/ippo-d1-s1-v0/robot", "--partners", "scratch/ippo-d9-*"]
    assert evaluate(registry, *words, "--split", "test", "--json") == 0
    summary = json.loads(capfd.readouterr().out)
    assert len(summary["egos"]) == 2
    assert list(summary["by_disability"]) == ["d9"]
    assert summary["m_test"]["n"] == 2 * summary["partners"]["test"]


@pytest.mark.slow
def test_crossplay_diagonal_is_self_play(registry: Path, tmp_path: Path, capfd):
    """Two teams of each setting; self-play is what `evaluate` gives for a robot's own human."""
    out, teams = tmp_path / "xp", "scratch/ippo-d?-s[01]-v0"
    words = [*SCRATCH, "--episodes", 2, "--registry", registry, "--out", out]
    words += ["--robots", f"{teams}/robot", "--humans", f"{teams}/human"]
    assert call("crossplay", *words, "--json") == 0
    summary = json.loads(capfd.readouterr().out)
    assert set(summary["self_play"]) >= FIGURE
    assert (summary["egos"], summary["partners"], summary["episodes"]) == (4, 4, 32)
    tables = ["episodes.parquet", "pairs.parquet", "order.json", "summary.json", "crossplay.png"]
    assert all((out / name).stat().st_size > 0 for name in tables)
    pairs = pl.read_parquet(out / "pairs.parquet")
    own = pairs.filter(pl.col("ego_team") == pl.col("partner_team"))
    assert own["return"].mean() == pytest.approx(summary["self_play"]["mean"])
    order = json.loads((out / "order.json").read_text())["teams"]["order"]
    assert sorted(order) == sorted(own["ego_team"])
    team = "scratch/ippo-d9-s1-v0"
    alone = ["--partners", f"{team}/human", "--split", "both", "--include-own", "--json"]
    assert evaluate(registry, *alone, policy=f"zoo:{team}/robot") == 0
    mean = json.loads(capfd.readouterr().out)["worst_partner"]["mean"]
    assert own.filter(pl.col("ego_team") == team)["return"].item() == pytest.approx(mean, rel=1e-6)
    before = (out / "episodes.parquet").stat().st_mtime_ns
    assert call("crossplay", *words) == 0
    assert "found finished" in capfd.readouterr().out
    assert (out / "episodes.parquet").stat().st_mtime_ns == before


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
    message = failure(capfd, evaluate(registry, policy="python:numpy_robot_of_a_test:wrong"))
    assert "zeros it returned float64 of shape (2, 6); expected floats of shape (2, 7)" in message
    assert "the robot of task scratch reads observations [N, 34] and gives actions" in message


def test_policy_file_of_another_task_is_refused(registry: Path, tmp_path: Path, capfd):
    mine, other = tmp_path / "mine.safetensors", tmp_path / "other.safetensors"
    write_policy_file(mine, ROBOT, params_of(ROBOT, 1))
    assert evaluate(registry, "--json", policy=mine) == 0
    capfd.readouterr()
    spec = PolicySpec("robot", observation_size=47, action_size=7, hidden=(8,))
    write_policy_file(other, spec, params_of(spec, 1))
    expected = "other.safetensors reads observations of 47 numbers; the robot of task scratch has"
    assert expected in failure(capfd, evaluate(registry, policy=other))


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
        (["zoo:scratch/ippo-d1-s00-v0/robot"], "nearest: scratch/ippo-d1-s0-v0/robot"),
        (["zoo:scratch/ippo-d1-s0-v0/robot"], "is given 2 times"),
        (["robot"], "unknown form; allowed are an id such as"),
        (["robot.py:make"], "did you mean python:robot.py:make?"),
        (["bed_bath/ippo-d1-s0-v0/robot"], "is of task bed_bath, not of scratch"),
        (["robot.onnx"], "there is no file robot.onnx"),
        (["robot.py"], "'robot.py': there is no file robot.py"),
        (["/"], "it is a folder: name a file in it"),
        (["python:never_imported:f", "--out", "/dev/null/x"], "choose another folder"),
    ],
)
def test_bad_input_gets_one_clear_line(registry: Path, words: list[str], message: str, capfd):
    assert message in failure(capfd, evaluate(registry, *words))


def test_a_release_of_another_environment_version_is_refused(registry: Path, capfd):
    text = registry.read_text()
    changed = text.replace('"environments": {"scratch": 1}', '"environments": {"scratch": 2}')
    assert changed != text
    registry.write_text(dump_registry(with_roots(parse_registry(changed, "edited"))))
    message = failure(capfd, evaluate(registry))
    assert "expected version 1 of environment scratch" in message
    assert "release v0, trained on version 2" in message


def run_apart(published: Path, folder: Path, code: str, *words: str, **variables: str) -> Any:
    """Evaluate a robot of a registry in a process of its own."""
    evaluation = ["evaluate", "--task", "scratch", "scratch/ippo-d9-s2-v0/robot"]
    return subprocess.run(
        [sys.executable, "-c", code, *evaluation, "--registry", str(published), *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), **variables},
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
def test_standard_output_of_a_process_is_one_json_object(published: Path, tmp_path: Path):
    """Whatever libraries print, when imported or from C, is not in it."""
    code = (
        "import assistax_envs.env, sys\n"
        f"assistax_envs.env.EPISODE_LENGTH = {STEPS}\n"
        "from assistax_zoo.shell.main import run\n"
        "sys.exit(run(sys.argv[1:]))\n"
    )
    words = ["--episodes", "1", "--backend", "native", "--json"]
    done = run_apart(published, tmp_path, code, *words)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["episodes"] == 3


@pytest.mark.slow
@pytest.mark.parametrize(("platform", "backend"), [("tpu", "native"), ("cuda", "auto")])
def test_missing_devices_get_one_line(
    published: Path, tmp_path: Path, platform: str, backend: str
) -> None:
    code = "from assistax_zoo.__main__ import start; import sys; sys.exit(start())"
    variables = {"JAX_PLATFORMS": platform, "CUDA_VISIBLE_DEVICES": ""}
    done = run_apart(published, tmp_path, code, "--backend", backend, **variables)
    [line] = [line for line in done.stderr.splitlines() if not line.startswith("WARNING")]
    assert done.returncode == 1
    assert line.startswith(f"error: JAX has no device of JAX_PLATFORMS={platform}")
    assert line.endswith("; unset JAX_PLATFORMS to use this machine's devices, or set it to cpu")
