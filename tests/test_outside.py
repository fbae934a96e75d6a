"""A package outside this repository adds to it, and the commands run with what it adds."""

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from assistax_base.extensions import COMMANDS, METHODS, METRICS, extensions
from evaluation.figures.metrics.installed import Metric, find_metrics
from population.hyperparameters import PPOConfig, robot_preset
from population.methods.method import method_class

OUTSIDE = Path(__file__).parent / "outside"
PACKAGE = {"package": "assistax-outside", "version": "0.1.0"}
TINY = [
    "--set",
    "num_envs=10",
    "--set",
    "minibatches=2",
    "--set",
    "rollout_steps=4",
    "--set",
    "hidden=(8,8)",
]
PARTNERS = ("--partners", "scratch/ippo-d1-s[01]-v1/human")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the package into a folder, without network."""
    folder = tmp_path_factory.mktemp("outside")
    options = "--quiet --no-deps --no-index --no-build-isolation --disable-pip-version-check"
    command = [sys.executable, "-m", "pip", "install", *options.split(), "--target", str(folder)]
    subprocess.run([*command, str(OUTSIDE)], check=True)
    return folder


def run(*words: str, package: Path | None = None, code: int = 0) -> str:
    """Run a command, with or without the package, and return its output, or its error."""
    path = [str(package)] if package else []
    path += [os.environ.get("PYTHONPATH", ""), str(Path(__file__).parents[1])]
    done = subprocess.run(
        [sys.executable, "-m", "assistax_zoo", *words],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stderr
    return done.stderr if code else done.stdout


@pytest.fixture(scope="module")
def evaluated(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a robot by the package's method, and evaluate it by the package's metric."""
    folder = tmp_path_factory.mktemp("study")
    train = (
        "train-ego",
        "--task",
        "scratch",
        "--split",
        "scratch/small-5",
        "--algorithm",
        "careful",
    )
    run(
        *train,
        "--backend",
        "native",
        *TINY,
        "--steps",
        "40",
        "--out",
        str(folder / "run"),
        package=installed,
    )
    [robot] = (folder / "run" / "policies").glob("careful-s0.safetensors")
    how = ("--split", "both", *PARTNERS, "--episodes", "1", "--backend", "native")
    options = ("--metrics", "unsteadiness", "--include-own", "--no-references")
    evaluate = ("evaluate", "--task", "scratch", "--policy", str(robot))
    text = run(*evaluate, *how, *options, "--out", str(folder / "results"), package=installed)
    assert "more, by assistax-outside" in text and "change of the force, N/s" in text
    return folder


def test_entry_points_name_what_can_be_loaded(
    install_package: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(OUTSIDE / "src")
    project = tomllib.loads((OUTSIDE / "pyproject.toml").read_text())["project"]
    for group, entries in project["entry-points"].items():
        for name, value in entries.items():
            install_package(group, name, value, package=f"outside{len(name)}{group[-3:]}")
    config = robot_preset("careful")
    assert isinstance(config, PPOConfig) and config.method == "careful"
    assert method_class("careful").__name__ == "Careful"
    assert isinstance(find_metrics(["unsteadiness"])["unsteadiness"].metric, Metric)
    assert callable(extensions(COMMANDS)["plot.forces"].load())
    assert [*extensions(METHODS), *extensions(METRICS)] == ["careful", "unsteadiness"]


def test_guide_shows_the_package() -> None:
    guide = (OUTSIDE.parents[1] / "docs" / "extend.md").read_text()
    files = [path.read_text() for path in OUTSIDE.rglob("*") if path.suffix in (".py", ".toml")]
    blocks = re.findall(r"```(?:python|toml)\n(.*?)```", guide, re.DOTALL)
    assert len(blocks) == 4
    for block in blocks:
        assert any(block in text for text in files), block


@pytest.mark.slow
def test_a_training_run_names_the_package(evaluated: Path) -> None:
    config = json.loads((evaluated / "run" / "config.json").read_text())
    assert config["environment"]["packages"] == {"assistax-outside": "0.1.0"}
    [team] = json.loads((evaluated / "run" / "teams.json").read_text())
    assert team["training"]["versions"]["assistax-outside"] == "0.1.0"


@pytest.mark.slow
def test_a_folder_names_the_package_of_its_columns(evaluated: Path) -> None:
    manifest = json.loads((evaluated / "results" / "manifest.json").read_text())
    assert manifest["identity"]["columns"] == {"unsteadiness": PACKAGE}
    summary = json.loads((evaluated / "results" / "summary.json").read_text())
    figure = summary["more"]["unsteadiness"]
    assert figure["n"] == 1 and {name: figure[name] for name in PACKAGE} == PACKAGE


@pytest.mark.slow
def test_report_and_figure_show_the_metric(
    installed: Path, evaluated: Path, tmp_path: Path
) -> None:
    results = str(evaluated / "results")
    for package in (installed, None):  # a reader need not have it
        run("report", results, "--out", str(tmp_path / "page.html"), package=package)
        page = (tmp_path / "page.html").read_text()
        assert "change of the force, N/s (unsteadiness, assistax-outside 0.1.0)" in page
    run("plot", "forces", results, "--out", str(tmp_path / "forces.svg"), package=installed)
    assert "peak force, N" in (tmp_path / "forces.svg").read_text()


@pytest.mark.slow
def test_replay_says_what_it_cannot_compute_again(installed: Path, evaluated: Path) -> None:
    results = str(evaluated / "results")
    replay = ("replay", results, "--run-code", "--json")
    here = json.loads(run(*replay, package=installed))
    assert here["verdict"] == "same" and not any("cannot be told" in n for n in here["unchecked"])
    without = json.loads(run(*replay))
    assert without["verdict"] == "same"
    assert (
        "metric 'unsteadiness' of 'assistax-outside 0.1.0', which is not installed: cannot be "
        in ("".join(without["unchecked"]))
    )


@pytest.mark.slow
def test_a_crossplay_has_the_metric(installed: Path, tmp_path: Path) -> None:
    teams = ("--egos", "scratch/ippo-d1-s[01]-v1/robot", *PARTNERS)
    how = ("--episodes", "1", "--backend", "native", "--metrics", "unsteadiness")
    out = str(tmp_path / "xp")
    options = ("--out", out, "--json")
    text = run("crossplay", "--task", "scratch", *teams, *how, *options, package=installed)
    assert json.loads(text)["more"]["unsteadiness"]["n"] == 4


@pytest.mark.slow
def test_names_are_unknown_without_the_package(tmp_path: Path) -> None:
    for words, message in (
        (("train-ego", "--task", "scratch", "--algorithm", "careful"), "algorithm is 'careful'"),
        (
            ("evaluate", "--task", "scratch", "--policy", "x", "--metrics", "unsteadiness"),
            "metric is 'unsteadiness'; no installed package has one",
        ),
    ):
        assert message in run(*words, "--out", str(tmp_path / "out"), code=1)
