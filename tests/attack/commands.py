"""The commands under attack: what they are called with, and what must be the same in the end."""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from population.networks.spec import PolicySpec
from tests.untrained import published, teams_of

ROBOT = PolicySpec("robot", observation_size=2, action_size=1, hidden=(8,))
HUMAN = PolicySpec("human", observation_size=3, action_size=2, hidden=(8,))
# Figures of the machine, not of the policies.
UNSTEADY = {"env_steps_per_second", "seconds", "date", "made_with", "sha256", "versions"}
Figures = Mapping[str, str]


@dataclasses.dataclass(frozen=True)
class Command:
    """Words of a command, and its figures in the folder where it ran."""

    words: Sequence[str]
    figures: Callable[[Path], Figures]


def small_zoo(folder: Path) -> Path:
    """Publish four teams, and return their registry."""
    return published(teams_of(2, ROBOT, HUMAN), folder)


def commands(registry: Path, run: Path, result: Path) -> dict[str, Command]:
    """Return the commands; a finished training run and a finished evaluation are given to some."""
    toy = ["--task", "scratch", "--backend", "native"]
    zoo = ["--registry", str(registry)]
    ego = ["zoo:scratch/ippo-d1-s0-v0/robot", "--episodes", "2", "--max-envs", "2"]
    return {
        "evaluate": Command(["evaluate", *toy, *zoo, *ego, "--out", "out"], results_of("out")),
        "crossplay": Command(
            ["crossplay", *toy, *zoo, "--episodes", "1", "--max-envs", "4", "--out", "out"],
            results_of("out"),
        ),
        "train": Command([*TRAIN, "--out", "out"], files_of("out", "*.safetensors")),
        "publish": Command(
            [*f"publish {run} --release v1 --date 2027-01-31".split(), *MINE],
            files_of("mine", "**/*.*"),
        ),
        "fetch": Command(
            ["fetch", "--from", str(registry.parent)], files_of("cache", "**/*.safetensors")
        ),
        "report": Command(["report", str(result), "--out", "page.html"], files_of(".", "*.html")),
        "render": Command(RENDER.split(), files_of(".", "*.png")),
    }


RENDER = "render --task scratch --robot random --human zero --out strip.png --steps 8"
RENDER += " --width 64 --height 48"
MINE = ["--registry", "mine/registry.json"]
TRAIN = ["train", "--task", "scratch", "--disability", "d1", "--seeds", "1", "--steps", "192"]
TRAIN += ["--backend", "native", "--num-envs", "4", "--set", "rollout_steps=8"]
TRAIN += ["--set", "minibatches=2", "--set", "hidden=(8, 8)", "--self-play-episodes", "0"]


def results_of(name: str) -> Callable[[Path], Figures]:
    """Return what reads a results folder: its tables by their bytes, its summary by its figures."""

    def read(home: Path) -> Figures:
        figures = dict(files_of(name, "*.parquet")(home))
        for path in (home / name).glob("*.json"):
            if path.name not in ("manifest.json", "run.json"):
                figures[path.name] = digest(json.dumps(_steady(json.loads(path.read_text()))))
        return figures

    return read


def files_of(folder: str, pattern: str) -> Callable[[Path], Figures]:
    """Return what reads the files that anybody would take for finished: hidden ones are not."""

    def read(home: Path) -> Figures:
        root = home / folder
        paths = [path for path in root.glob(pattern) if path.is_file()]
        visible = [path for path in paths if not path.name.startswith(".")]
        return {
            str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in visible
        }

    return read


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _steady(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _steady(part) for name, part in value.items() if name not in UNSTEADY}
    return [_steady(part) for part in value] if isinstance(value, list) else value
