"""A figure traced to bytes: one bit of any file that it depends on is found, wherever it lies."""

import contextlib
import json
import os
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_zoo.shell.main import run
from evaluation.play.how import PlaySettings
from evaluation.record import manifest as provenance
from evaluation.record import verification
from evaluation.record.tables import (
    BOUNDS_FILE,
    EPISODES_FILE,
    PAIRS_FILE,
    read_episodes,
    read_parquet,
    write_parquet,
)
from evaluation.record.verification import check_sources
from evaluation.replay.replay import replay_folder
from tests.attack.commands import ROBOT, small_zoo
from tests.population.toy_env import ToyEnv, match
from tests.studies import cross_play, evaluate_policies
from tests.untrained import params_of
from zoo.parameters.storage import write_policy_file
from zoo.registry import Registry, load_registry

CODE = """
import numpy as np
import gain
DEPENDS = ["bias.npy"]
def make(weights):
    sizes = np.load(weights).sum() * gain.GAIN + np.load(__file__.replace("mine.py", "bias.npy"))
    return lambda obs: np.full((len(obs), %d), sizes, np.float32)
"""


def write_robots(folder: Path) -> list[str]:
    """Write a robot of Python code, and a policy file; return how to name them."""
    folder.mkdir()
    (folder / "mine.py").write_text(CODE % ROBOT.action_size)
    (folder / "gain.py").write_text("GAIN = 0.5\n")
    np.save(folder / "weights.npy", np.full(4, 0.1, np.float32))
    np.save(folder / "bias.npy", np.float32(0.1))
    write_policy_file(folder / "own.safetensors", ROBOT, params_of(ROBOT, 7))
    code = f"python:{folder}/mine.py:make?weights={folder}/weights.npy"
    return [code, str(folder / "own.safetensors")]


@pytest.fixture
def folder(home: Path, tmp_path: Path) -> Path:
    """A copy of the evaluation, as it is received."""
    return Path(shutil.copytree(home / "out", tmp_path / "out"))


def toy(task: str, backend: str = "native", **_: Any) -> ToyEnv:
    """Return an environment that is quick to compile."""
    made = ToyEnv(match)
    made.task, made.backend = task, "native"
    return made


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A zoo, robots, a cross-play, and an evaluation that draws on all of them."""
    home = tmp_path_factory.mktemp("home")
    registry = load_registry(small_zoo(home / "zoo"))
    settings = PlaySettings("scratch", 1, backend="native")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assistax_envs.make", toy)
        # They read the true tasks' observations.
        patch.setattr("evaluation.play.baselines.SCRIPTS", {})
        cross_play(registry, "scratch/*", "scratch/*", settings, home / "crossplay")
        robots = ["zoo:scratch/ippo-d1-s0-v0/robot", *write_robots(home / "mine")]
        others = {"references": home / "kept", "crossplay": home / "crossplay"}
        evaluate_policies(registry, robots, settings, home / "out", **others)
        provenance.write_run(home / "out", "assistax-zoo evaluate", simulated=True)
        yield home


def passes(*words: str) -> bool:
    """Return the verdict of the command."""
    try:
        return run(["verify", *words, "--json"]) == 0
    except SystemExit:
        return False


def files_of(home: Path) -> list[Path]:
    """Return every file that the manifest lists, and those that policies are read from."""
    manifest = provenance.read_manifest(home / "out") or {}
    listed = manifest["sources"]
    registry = load_registry(home / "zoo" / "registry.json")
    named = [name for release in listed["releases"].values() for name in release["policies"]]
    shards = {entry.shard for entry in registry.policies if entry.id in named}
    return [
        *(home / "out" / name for name in (*manifest["files"], provenance.MANIFEST_FILE)),
        *map(Path, listed["files"]),
        *(registry.shard_path(shard) for shard in sorted(shards)),
    ]


def flipped(data: bytes, place: int, bit: int) -> bytes:
    return data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :]


@pytest.mark.slow
def test_one_bit_of_any_file_is_found(home: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Of each, at its beginning, its end, and between."""
    files, rng = files_of(home), random.Random(0)
    names = {path.name for path in files}
    assert names >= {"manifest.json", "run.json", "summary.json", "episodes.parquet"}
    assert names >= {"mine.py", "gain.py", "weights.npy", "bias.npy", "own.safetensors"}
    kept = [path for path in files if path.is_relative_to(home / "kept")]
    shards = [path for path in files if path.is_relative_to(home / "zoo")]
    assert len(kept) == 2 and len(shards) == 2 and home / "crossplay" / "pairs.parquet" in files
    for path in files:
        whole = path.read_bytes()
        for place in (0, rng.randrange(len(whole)), len(whole) - 1):
            path.write_bytes(flipped(whole, place, 1))
            assert not passes(str(home / "out")), (path, place)
        path.write_bytes(whole)
    assert passes(str(home / "out")), capfd.readouterr().out


def test_one_bit_of_the_registry_is_found(home: Path) -> None:
    """Bits that no figure depends on are found by the registry's own check."""
    path, rng = home / "zoo" / "registry.json", random.Random(0)
    whole = path.read_bytes()
    [release] = (provenance.read_manifest(home / "out") or {})["sources"]["releases"].values()
    count = 0
    for _ in range(150):
        path.write_bytes(flipped(whole, rng.randrange(len(whole)), rng.randrange(8)))
        with contextlib.suppress(ValueError):
            if json.loads(path.read_bytes()) == json.loads(whole):
                continue
        found = bool(check_sources(home / "out").problems)
        assert found or not passes("--registry", str(path)), "neither check finds it"
        count += found
    path.write_bytes(whole)
    kinds = {name.partition(" ")[0] for name in release["entries"]}
    assert count > 50 and kinds == {"team", "run", "split", "setting", "shard"}


def test_planted_defect_unhashed_shards_are_caught(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The planted defect: parameters whose hash is not checked."""
    path = files_of(home)[-1]
    whole = path.read_bytes()
    path.write_bytes(flipped(whole, len(whole) // 2, 0))
    assert check_sources(home / "out").problems
    monkeypatch.setattr(verification, "load_leaves", lambda registry, entries: None)
    assert not check_sources(home / "out").problems
    path.write_bytes(whole)


def test_absent_sources_are_no_problem(home: Path, folder: Path) -> None:
    """A folder of another machine, with other files and another zoo; a zoo inside is not read."""
    resealed(folder, registry="/gone/registry.json", files={"/gone/weights.npy": "0" * 64})
    report = check_sources(folder)
    assert report.problems == () and len(report.absent) == 2
    assert "weights.npy" in report.absent[0] and "policies of '/gone/" in report.absent[1]
    zoo = Path(shutil.copytree(home / "zoo", folder / "zoo"))
    resealed(folder, registry=str((zoo / "registry.json").resolve()))
    assert "policies of" in check_sources(folder).absent[1]


def test_received_manifest_reading_is_bounded(folder: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    names = ["/dev/zero", str(tmp_path / "pipe"), str(tmp_path), "x\0y", "\x1b[31m" * 1000]
    resealed(folder, files=dict.fromkeys(names, "0" * 64))
    report = check_sources(folder)
    assert len(report.absent) == len(names) and "\x1b" not in "".join(report.absent)
    for nonsense in ([], {"files": 7}, {"files": {}, "registry": 7}, {"files": {"a": []}}):
        provenance.write_manifest(folder, {"sources": nonsense})
        assert check_sources(folder).problems


def test_kernel_files_are_not_read(folder: Path, tmp_path: Path) -> None:
    """`/proc/kmsg` never ends, and `/proc/self/pagemap` is terabytes long; a link may name both."""
    (tmp_path / "link").symlink_to("/proc/self/environ")
    names = ["/proc/self/environ", str(tmp_path / "link"), "/sys/kernel/profiling"]
    resealed(folder, files=dict.fromkeys(names, "0" * 64), registry="/proc/self/environ")
    report = check_sources(folder)
    assert report.problems == () and len(report.absent) == len(names) + 1


def test_repeated_file_is_read_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "large").write_bytes(b"x")
    names = [f"{tmp_path}{'/' * count}large" for count in range(1, 41)]
    read: list[Path] = []
    hashed = provenance.received_sha256
    monkeypatch.setattr(
        verification, "received_sha256", lambda path: read.append(path) or hashed(path)
    )
    resealed(folder, files=dict.fromkeys(names, provenance.file_sha256(tmp_path / "large")))
    assert not check_sources(folder).problems and len(read) == 1
    monkeypatch.setattr(verification, "LARGEST_SUM", 0)
    assert len(check_sources(folder).absent) == 40


def resealed(folder: Path, **changes: Any) -> None:
    """Write other sources into a manifest, consistently, as a sender can."""
    manifest = provenance.read_manifest(folder) or {}
    provenance.write_manifest(folder, {**manifest, "sources": {**manifest["sources"], **changes}})


def test_the_registry_is_the_one_that_is_given(home: Path, tmp_path: Path) -> None:
    zoo = Path(shutil.copytree(home / "zoo", tmp_path / "zoo"))
    other: Registry = load_registry(zoo / "registry.json")
    assert not check_sources(home / "out", other.path).problems
    other.shard_path(other.policies[0].shard).unlink()
    report = check_sources(home / "out", other.path)
    assert not report.problems and "parameters, in" in report.absent[0]


@pytest.mark.slow
def test_folder_of_code_and_crossplay_is_replayed(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its best responses rest on the cross-play, which is checked as well."""
    monkeypatch.setattr("assistax_envs.make", toy)
    monkeypatch.setattr("evaluation.play.baselines.SCRIPTS", {})
    registry = load_registry(home / "zoo" / "registry.json")
    bounds = read_parquet(home / "out" / BOUNDS_FILE)
    assert "cross-play" in bounds["source"].to_list()
    with pytest.raises(ValueError, match="is code, and the folder names it"):
        replay_folder(home / "out", registry)
    with pytest.raises(ValueError, match="give its folder as well"):
        replay_folder(home / "out", registry, run_code=True)
    options: dict[str, Any] = {"run_code": True, "crossplay": home / "crossplay"}
    report = replay_folder(home / "out", registry, **options)
    assert report.ok and report.exact and not report.unchecked, report
    path = home / "crossplay" / PAIRS_FILE
    whole, manifest = path.read_bytes(), (home / "crossplay" / "manifest.json").read_bytes()
    write_parquet(read_parquet(path).with_columns(pl.col("return") + 1), path)
    provenance.seal(home / "crossplay")
    report = replay_folder(home / "out", registry, **options)
    assert not report.ok and "pairs.parquet is not what its episodes give" in report.problems[0]
    path.write_bytes(whole)
    (home / "crossplay" / "manifest.json").write_bytes(manifest)


SETTINGS = PlaySettings("scratch", 1, backend="native")


def evaluated(home: Path, robot: str, folder: Path) -> list[float]:
    """Evaluate one robot, and return M_test and the episodes' returns."""
    registry = load_registry(home / "zoo" / "registry.json")
    summary = evaluate_policies(registry, [robot], SETTINGS, folder)
    table = read_episodes(folder / EPISODES_FILE)
    assert summary.m_test is not None
    return [summary.m_test.mean, *table["return"].to_list()]


@pytest.mark.slow
def test_changed_weights_are_not_answered_from_folder(home: Path, tmp_path: Path) -> None:
    """With the files declared it is another robot; undeclared, it may be, and is refused too."""
    robot, _ = write_robots(tmp_path / "mine")
    weights = tmp_path / "mine" / "weights.npy"
    first = evaluated(home, robot, tmp_path / "declared")
    assert evaluated(home, robot, tmp_path / "declared") == first
    np.save(weights, np.full(4, -0.4, np.float32))
    with pytest.raises(ValueError, match=r"holds another job \(other egos"):
        evaluated(home, robot, tmp_path / "declared")
    code = (tmp_path / "mine" / "mine.py").read_text()
    undeclared = code.replace("DEPENDS", "FILES").replace("make(weights)", "make()")
    undeclared = undeclared.replace("np.load(weights)", f"np.load({str(weights)!r})")
    (tmp_path / "mine" / "mine.py").write_text(undeclared)
    robot = robot.partition("?")[0]
    second = evaluated(home, robot, tmp_path / "undeclared")
    np.save(weights, np.full(4, 0.1, np.float32))
    with pytest.raises(ValueError, match="whether that is still the same robot"):
        evaluated(home, robot, tmp_path / "undeclared")
    assert evaluated(home, robot, tmp_path / "elsewhere") == first != second


def test_leaves_have_hashes_or_errors() -> None:
    """The one comparison of files, policies and a registry's entries."""
    here: dict[str, Any] = {"whole": "a", "other": "b", "absent": None}

    def digest(name: str) -> str | None:
        if name == "broken":
            raise OSError("no regular file")
        return here[name]

    leaves = list(verification.compare(dict.fromkeys([*here, "broken"], "a"), digest))
    assert [leaf.actual == leaf.expected for leaf in leaves] == [True, False, False, False]
    assert [leaf.actual for leaf in leaves] == ["a", "b", None, None]
    assert str(leaves[3].error) == "no regular file" and leaves[2].error is None
