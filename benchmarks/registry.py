"""Speed of the zoo's commands on a synthetic registry: list, verify, and fetch over loopback."""

import contextlib
import dataclasses
import itertools
import json
import os
import pty
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from assistax_envs.disability import DISABILITY_SETTINGS
from assistax_workshop.press.publish import publish
from population.networks.spec import PolicySpec, Role
from population.runs.trained import TrainedTeam
from zoo.locations import CACHE_VARIABLE
from zoo.registry import Registry

REPEATS = 5  # of each measurement; the median is the figure
ALGORITHMS = ("ippo", "mappo", "isac", "masac")
SPECS: dict[Role, PolicySpec] = {
    "robot": PolicySpec("robot", 34, 7, hidden=(128, 128)),
    "human": PolicySpec("human", 38, 3, hidden=(128, 128)),
}


@dataclasses.dataclass(frozen=True)
class ZooSpeed:
    """Wall time of whole commands, their interpreter included; medians."""

    policies: int
    shards: int
    bytes: int  # of all shards
    python_seconds: float  # an interpreter that does nothing
    list_seconds: float  # into a pipe
    list_terminal_seconds: float
    verify_seconds: float
    fetch_seconds: float  # of all shards, from another process on loopback
    fetch_mb_per_second: float  # best of the repeats, since other work only slows it down
    fetch_repeats: tuple[float, ...]


def measure_zoo(folder: Path, policies: int, command: Sequence[str]) -> ZooSpeed:
    """Return the wall times of the commands, measured in an empty folder.

    Args:
        folder: Empty folder for the registry and the caches.
        policies: Number of policies in the registry.
        command: Words that start the command line.
    """
    registry = synthetic_registry(folder / "zoo" / "registry.json", policies)
    size = sum(shard.bytes for shard in registry.data.shards.values())
    there = ["--registry", str(registry.path)]
    listing = [*command, "list", *there]
    with _web_server(folder / "zoo") as url:
        fetches = [
            _fetch_seconds(command, url, folder / f"cache-{number}") for number in range(REPEATS)
        ]
    return ZooSpeed(
        policies=len(registry.policies),
        shards=len(registry.data.shards),
        bytes=size,
        python_seconds=_median([sys.executable, "-c", "pass"]),
        list_seconds=_median(listing),
        list_terminal_seconds=statistics.median(_on_terminal(listing) for _ in range(REPEATS)),
        verify_seconds=_median([*command, "verify", *there]),
        fetch_seconds=statistics.median(fetches),
        fetch_mb_per_second=size / 1e6 / min(fetches),
        fetch_repeats=tuple(size / 1e6 / seconds for seconds in fetches),
    )


def synthetic_registry(path: Path, policies: int) -> Registry:
    """Return a registry of teams with random parameters, of all algorithms and settings in turn."""
    groups = list(itertools.product(DISABILITY_SETTINGS, ALGORITHMS))
    teams = [
        _team(number // len(groups), *groups[number % len(groups)])
        for number in range(policies // 2)
    ]
    return publish(teams, path, "v0", date="2027-01-31", check=lambda spec, leaves, source: None)


def _team(seed: int, disability: str, algorithm: str) -> TrainedTeam:
    """Return a team with random parameters."""
    rng = np.random.default_rng([seed, int(disability[1:]), ALGORITHMS.index(algorithm)])
    return TrainedTeam(
        task="scratch",
        algorithm=algorithm,
        disability=disability,
        seed=seed,
        specs=SPECS,
        params={role: _params(spec, rng) for role, spec in SPECS.items()},
        training={
            "run": f"scratch-{algorithm}",
            "steps": 10_000_000,
            "env_version": 1,
            "backend": "native",
        },
        self_play={"mean": 950.5, "iqm": 952.25, "mean_ci": [940.0, 960.0], "n": 16},
    )


def _params(spec: PolicySpec, rng: np.random.Generator) -> dict[str, Any]:
    widths = (spec.observation_size, *spec.hidden, spec.action_size)
    return {
        f"Dense_{i}": {
            "kernel": rng.random(shape, np.float32),
            "bias": rng.random(shape[1], np.float32),
        }
        for i, shape in enumerate(itertools.pairwise(widths))
    }


def _median(words: Sequence[str]) -> float:
    """Return the median wall time of a command."""
    return statistics.median(_seconds(words) for _ in range(REPEATS))


def _seconds(words: Sequence[str]) -> float:
    began = time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.PIPE)
    return time.perf_counter() - began


def _on_terminal(words: Sequence[str]) -> float:
    """Return the wall time of a command that writes to a terminal."""
    began = time.perf_counter()
    master, slave = pty.openpty()
    try:
        with subprocess.Popen(words, stdout=slave) as process:
            os.close(slave)
            with contextlib.suppress(OSError):  # the end of a terminal's output
                while os.read(master, 1 << 16):
                    pass
    finally:
        os.close(master)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, list(words))
    return time.perf_counter() - began


def _fetch_seconds(command: Sequence[str], url: str, cache: Path) -> float:
    """Return the seconds that `fetch --json` reports for all shards, with an empty cache."""
    environment = {**os.environ, CACHE_VARIABLE: str(cache)}
    words = [*command, "fetch", "--from", url, "--json"]
    done = subprocess.run(
        words, check=True, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    return json.loads(done.stdout)["seconds"]


@contextlib.contextmanager
def _web_server(folder: Path) -> Generator[str]:
    """Yield the address of a web server of a folder."""
    options = ["--bind", "127.0.0.1", "--directory", str(folder)]
    words = [sys.executable, "-u", "-m", "http.server", "0", *options]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            match = re.search(r"port (\d+)", process.stdout.readline())
            if match is None:
                raise OSError("the web server for the measurement did not start")
            yield f"http://127.0.0.1:{match[1]}"
        finally:
            process.terminate()
