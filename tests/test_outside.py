"""A package outside the source tree, installed, with every command that its additions meet."""

import json
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "tests/outside"
PROGRAM = Path(sys.executable).with_name("assistax-zoo")
TASK, RELEASE = "gentle_wave", "v0"
TINY = [
    *("--steps", "1", "--num-envs", "4", "--backend", "native"),
    *("--set", "rollout_steps=10", "--set", "hidden=[8]"),
    *("--set", "minibatches=1", "--set", "epochs=1"),
]


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the package, installed without network."""
    folder = tmp_path_factory.mktemp("site")
    options = ["--no-deps", "--no-index", "--no-build-isolation", "--no-cache-dir"]
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    subprocess.run([*command, *options, "--target", str(folder), str(SOURCE)], check=True)
    return folder


class Shell:
    """Runs commands with the package installed, and a registry of the user's own."""

    def __init__(self, site: Path, folder: Path) -> None:
        paths = [site, ROOT, ROOT / "workshop", ROOT / "board"]
        self.folder, self.registry = folder, folder / "zoo/registry.json"
        self._environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(map(str, paths)),
            "ASSISTAX_ZOO_DATA": str(folder / "data"),
        }

    def python(self, *words: str) -> str:
        return self._run(sys.executable, *words)

    def __call__(self, *words: Any) -> str:
        return self._run(str(PROGRAM), *map(str, words))

    def _run(self, *words: str) -> str:
        done = subprocess.run(
            words, env=self._environment, cwd=ROOT, capture_output=True, text=True
        )
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}{done.stderr}"
        return done.stdout


@pytest.fixture(scope="session")
def shell(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Shell:
    """Return a shell whose registry has two teams and the persons of the outside task."""
    shell = Shell(site, tmp_path_factory.mktemp("outside"))
    teams = shell.folder / "teams"
    shell("publish", "--persons", TASK, "--release", RELEASE, "--registry", shell.registry)
    settings = ["--disability", "d1,d9", "--self-play-episodes", "0"]
    shell("train", "--task", TASK, *settings, *TINY, "--out", teams)
    shell("publish", teams, "--release", RELEASE, "--registry", shell.registry)
    return shell


@pytest.fixture(scope="session")
def robot(shell: Shell) -> Path:
    """Return a robot that the outside method trained with persons of the outside task."""
    folder = shell.folder / "ego"
    options = ["--partners", "persons", "--algorithm", "careful", "--registry", shell.registry]
    shell("train-ego", "--task", TASK, *options, *TINY, "--out", folder)
    return next((folder / "policies").glob("*.safetensors"))


@pytest.mark.slow
def test_additions_are_found_by_name(site: Path) -> None:
    code = (
        "import json; from assistax_base.extensions import GROUPS, extensions;"
        "print(json.dumps({group: {n: e.package for n, e in extensions(group).items()"
        " if e.package == 'assistax-outside'} for group in GROUPS}))"
    )
    found = json.loads(Shell(site, site).python("-c", code))
    assert {group.removeprefix("assistax_zoo."): list(names) for group, names in found.items()} == {
        "tasks": [TASK],
        "partners": ["resting"],
        "methods": ["careful"],
        "metrics": ["unsteadiness"],
        "families": ["weary"],
        "commands": ["plot.forces"],
        "groups": [],
    }


def test_each_addition_is_one_file_or_folder() -> None:
    text = (SOURCE / "pyproject.toml").read_text()
    places = re.findall(r'^"?[\w.]+"? = "(assistax_outside\.\w+):\w+"$', text, re.M)
    files = {path.stem for path in (SOURCE / "src/assistax_outside").iterdir()}
    assert len(places) == 6
    assert {place.split(".")[1] for place in places} == files - {"__init__", "__pycache__"}


def test_page_prints_the_code_of_the_package() -> None:
    page = (ROOT / "docs/extend.md").read_text()
    blocks = re.findall(r"```(?:python|toml)\n(.*?)```", page, re.S)
    files = [path.read_text() for path in SOURCE.rglob("*.*") if path.suffix in (".py", ".toml")]
    assert len(blocks) == 7
    assert [block for block in blocks if not any(block.strip() in file for file in files)] == []


def test_an_uninstalled_package_adds_nothing() -> None:
    assert "assistax-outside" not in {found.name for found in metadata.distributions()}


@pytest.mark.slow
def test_evaluation_has_the_outside_metric(shell: Shell, robot: Path) -> None:
    folder = shell.folder / "evaluation"
    options: list[Any] = [
        "--partners",
        "persons",
        "--persons",
        "2",
        "--episodes",
        "1",
        "--no-references",
    ]
    options += ["--registry", shell.registry, "--metrics", "unsteadiness", "--backend", "native"]
    text = shell("evaluate", "--task", TASK, robot, *options, "--out", folder, "--json")
    figure = json.loads(text)["more"]["unsteadiness"]
    assert (figure["package"], figure["version"]) == ("assistax-outside", "0.1.0")
    page, drawing = shell.folder / "page.html", shell.folder / "forces.png"
    shell("report", folder, "--out", page)
    assert "change of the force, N/s (unsteadiness, assistax-outside 0.1.0)" in page.read_text()
    shell("plot", "forces", folder, "--out", drawing)
    assert drawing.stat().st_size > 1000


@pytest.mark.slow
def test_outside_kind_of_partner_plays(shell: Shell, robot: Path) -> None:
    options: list[Any] = ["--partners", "resting", "--episodes", "1", "--no-references"]
    options += ["--registry", shell.registry, "--backend", "native", "--json"]
    text = shell("evaluate", "--task", TASK, robot, *options)
    assert json.loads(text)["partners"]["test"] == 2


@pytest.mark.slow
def test_outside_teams_are_cross_played(shell: Shell) -> None:
    folder = shell.folder / "crossplay"
    options: list[Any] = ["--humans", f"{TASK}/ippo-*/human", "--robots", f"{TASK}/ippo-*/robot"]
    options += ["--episodes", "1", "--preferences", "p1", "--backend", "native"]
    options += ["--registry", shell.registry, "--out", folder, "--json"]
    summary = json.loads(shell("crossplay", "--task", TASK, *options))
    assert (summary["egos"], summary["partners"]) == (2, 2)


@pytest.mark.slow
def test_the_outside_task_is_filmed(shell: Shell) -> None:
    picture = shell.folder / "wave.png"
    seats = ["--robot", "zero", "--human", "zero", "--steps", "8"]
    shell("render", "--task", TASK, *seats, "--out", picture)
    assert picture.stat().st_size > 1000


@pytest.mark.slow
def test_the_outside_task_is_trained_for_the_gates(shell: Shell) -> None:
    options = ["--only", "teams", "--seeds", "1", "--steps", "1", "--backend", "native"]
    sizes = [word for word in TINY[6:] if word != "--backend"] + ["--set", "num_envs=4"]
    shell("gates", "train", TASK, shell.folder / "gates", *options, *sizes)
    assert any((shell.folder / "gates/teams").rglob("*.safetensors"))


@pytest.mark.slow
def test_outside_teams_are_audited(shell: Shell) -> None:
    options: list[Any] = ["--team", f"{TASK}/ippo-*", "--registry", shell.registry]
    options += ["--episodes", "2"]
    options += ["--backend", "native", "--json"]
    audit = json.loads(shell("audit", TASK, *options))
    assert (audit["task"], audit["env_version"], len(audit["teams"])) == (TASK, 1, 2)
    assert {"script, passive human", "mistaken humans"} <= audit["figures"].keys()


@pytest.mark.slow
def test_outside_persons_have_gates(shell: Shell) -> None:
    folder = shell.folder / "gates-persons"
    sizes = ["--single", "2", "--backend", "native", "--json"]
    gates = json.loads(shell("gates", "persons", TASK, folder, "--only", "script", *sizes))
    assert gates[-1]["gate"] == "numbers inside their ranges" and gates[-1]["holds"]
    played = json.loads((folder / "script.json").read_text())
    assert played["about"]["task"] == TASK
    assert len(played["sides"]["unseen"]["return"][0]) == 200


@pytest.mark.slow
def test_the_outside_task_keeps_the_contract(shell: Shell) -> None:
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", TASK]
    assert "passed" in shell.python(*words, "tests/envs/test_contract.py")


@pytest.mark.slow
def test_replay_tells_metrics_it_cannot_compute(shell: Shell) -> None:
    folder = shell.folder / "replayed"
    teams = ["--robots", "scratch/ippo-d1-s0-v1/robot", "--humans", "scratch/ippo-d1-s0-v1/human"]
    how = ["--episodes", "1", "--backend", "native", "--metrics", "unsteadiness"]
    shell("crossplay", "--task", "scratch", *teams, *how, "--out", folder)
    here = json.loads(shell("replay", folder, "--json"))
    assert here["verdict"] == "same" and not any("cannot be told" in n for n in here["unchecked"])
    words = [sys.executable, "-m", "assistax_zoo", "replay", str(folder), "--json"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    without = json.loads(done.stdout)
    assert without["verdict"] == "same"
    missing = "metric 'unsteadiness' of 'assistax-outside 0.1.0', which is not installed: cannot be"
    assert missing in "".join(without["unchecked"])


@pytest.mark.slow
def test_trained_robots_name_their_package(shell: Shell, robot: Path) -> None:
    run = robot.parents[1]
    config = json.loads((run / "config.json").read_text())
    assert config["environment"]["packages"]["assistax-outside"] == "0.1.0"
    [team] = json.loads((run / "teams.json").read_text())
    assert team["training"]["versions"]["assistax-outside"] == "0.1.0"
