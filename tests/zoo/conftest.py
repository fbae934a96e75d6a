"""A small population of random teams, and a registry that holds it."""

import dataclasses
import itertools
import json
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assistax_envs.versions import VERSIONS
from assistax_workshop.press.publish import publish
from population.networks.spec import PolicySpec
from population.runs.trained import TrainedTeam
from tests.zoo.hub_server import Hub
from zoo.registry import Registry, load_registry
from zoo.transport import remotes

SPECS = {
    "robot": PolicySpec("robot", 5, 2, hidden=(4,)),
    "human": PolicySpec("human", 6, 3, hidden=(4,)),
}
SELF_PLAY = {"mean": 950.5, "iqm": 952.25, "mean_ci": [940.0, 960.0], "n": 16}


def random_params(spec: PolicySpec, seed: int, dtype: type = np.float32) -> dict[str, Any]:
    """Return the leaves of `Policy(spec)` for a feed-forward spec, at random."""
    rng = np.random.default_rng(seed)
    widths = (spec.observation_size, *spec.hidden, spec.action_size)
    params: dict[str, Any] = {
        f"Dense_{i}": {
            "kernel": rng.normal(size=(a, b)).astype(dtype),
            "bias": rng.normal(size=b).astype(dtype),
        }
        for i, (a, b) in enumerate(itertools.pairwise(widths))
    }
    size = spec.observation_size
    params["log_std"] = rng.normal(size=spec.action_size).astype(dtype)
    params["normaliser"] = {"mean": np.zeros(size, dtype), "std": np.ones(size, dtype)}
    return params


def trained_team(
    algorithm: str = "ippo", disability: str = "d1", seed: int = 0, **changes: Any
) -> TrainedTeam:
    """Return a team whose parameters follow from its name."""
    noise = zlib.crc32(f"{algorithm}-{disability}-{seed}".encode())
    specs, task = changes.pop("specs", SPECS), changes.get("task", "scratch")
    fields: dict[str, Any] = {
        "task": task,
        "algorithm": algorithm,
        "disability": disability,
        "seed": seed,
        "specs": specs,
        "params": {
            role: random_params(spec, noise + index)
            for index, (role, spec) in enumerate(specs.items())
        },
        "training": {
            "run": f"scratch-{algorithm}",
            "steps": 10_000_000,
            "env_version": VERSIONS.get(task, 1),
            "backend": "native",
            "versions": {"jax": "0.10.2"},
            "hyperparameters": {"learning_rate": 1e-3, "anneal_lr": False},
        },
        "self_play": SELF_PLAY,
    }
    return TrainedTeam(**{**fields, **changes})


def trained_teams(
    algorithms=("ippo",), disabilities=("d1", "d9"), seeds=range(4)
) -> list[TrainedTeam]:
    return [trained_team(a, d, s) for a in algorithms for d in disabilities for s in seeds]


def put(teams: list[TrainedTeam], path: Path, release: str = "v0", **arguments: Any) -> Registry:
    """Publish without asking JAX for the leaves of each spec."""
    arguments = {"date": "2027-01-31", "check": lambda spec, leaves, source: None, **arguments}
    return publish(teams, path, release, **arguments)


def edit(registry: Registry, change: Callable[[dict[str, Any]], object]) -> Path:
    """Change the JSON of a registry in place, and return its path."""
    data = json.loads(registry.path.read_text())
    change(data)
    registry.path.write_text(json.dumps(data))
    return registry.path


def edited(registry: Registry, change: Callable[[dict[str, Any]], object]) -> Registry:
    """Return a registry after a change in its JSON, loaded without a check of its roots."""
    return load_registry(edit(registry, change), roots=False)


def leftovers(folder: Path, pattern: str = ".*") -> list[Path]:
    """Return files that no finished fetch leaves. Locks are empty and stay."""
    files = [path for path in folder.rglob(pattern) if path.is_file()]
    return [path for path in files if path.suffix != ".lock" or path.stat().st_size]


def visible(folder: Path) -> list[str]:
    """Return the sorted names of a cache's whole shards."""
    names = {path.name for path in folder.rglob("*.safetensors")}
    return sorted(name for name in names if not name.startswith("."))


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, "nothing happened within a minute"
        time.sleep(0.01)


@pytest.fixture
def team() -> Callable[..., TrainedTeam]:
    return trained_team


@pytest.fixture
def teams() -> Callable[..., list[TrainedTeam]]:
    return trained_teams


@pytest.fixture
def publish_to() -> Callable[..., Registry]:
    return put


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """A registry with eight teams: ippo, d1 and d9, seeds 0 to 3."""
    return put(trained_teams(), tmp_path / "registry.json")


@pytest.fixture
def specs() -> dict[str, PolicySpec]:
    return dict(SPECS)


@pytest.fixture
def params() -> Callable[..., dict[str, Any]]:
    return random_params


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder, and no remote but those that a test names."""
    path = tmp_path / "cache"
    monkeypatch.setenv("ASSISTAX_ZOO_CACHE", str(path))
    monkeypatch.delenv("ASSISTAX_ZOO_REMOTE", raising=False)
    return path


@pytest.fixture
def hub(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    """A hub on loopback that the real client talks to, and an empty cache."""
    from huggingface_hub import constants
    from huggingface_hub.utils import close_session

    monkeypatch.setattr(remotes, "RETRY", remotes.Retry(attempts=3, pause=0.01))
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    with Hub().running() as server:
        monkeypatch.setattr(constants, "ENDPOINT", server.url)
        template = f"{server.url}/{{repo_id}}/resolve/{{revision}}/{{filename}}"
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        yield server
        close_session()


@pytest.fixture
def large(tmp_path: Path) -> Registry:
    """A registry whose two shards have half a megabyte each."""
    specs = {role: dataclasses.replace(spec, hidden=(128, 128)) for role, spec in SPECS.items()}
    teams = [trained_team(seed=seed, specs=specs) for seed in range(8)]
    return put(teams, tmp_path / "large" / "registry.json")


@pytest.fixture
def bare(large: Registry, hub: Hub, tmp_path: Path) -> Registry:
    """The large registry without its shards, which the hub has."""
    hub.put("org/zoo", large.path.parent)
    path = tmp_path / "bare" / "registry.json"
    path.parent.mkdir()
    path.write_bytes(large.path.read_bytes())
    return load_registry(path)
