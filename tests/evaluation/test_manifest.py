"""A folder's figures traced to bytes: a change is found, and a sample can be played again."""

import contextlib
import json
import random
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import jax
import polars as pl
import pytest

from assistax_zoo.shell.main import run
from evaluation.play.how import PlaySettings
from evaluation.record import manifest as provenance
from evaluation.record import tables
from evaluation.record.record import Record
from evaluation.record.verification import check_whole, verify_folder
from evaluation.replay import rederive, replay
from evaluation.replay.job import rebuild_job
from evaluation.replay.replay import replay_folder
from tests import untrained
from tests.attack import forging
from tests.attack.forging import Forger
from tests.studies import evaluate_policies
from zoo.registry import Registry, load_registry

STEPS = 20
DERIVED_TABLES = (tables.PARTNERS_FILE, tables.PROFILE_FILE, tables.BOUNDS_FILE)
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    return load_registry(untrained.published(untrained.teams_of(4), tmp_path_factory.mktemp("zoo")))


@pytest.fixture(scope="module")
def made(registry: Registry, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation with its references, of episodes of few steps."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assistax_envs.env.EPISODE_LENGTH", STEPS)
        evaluate_policies(
            registry,
            ["zoo:scratch/ippo-d1-s0-v0/robot"],
            PlaySettings("scratch", 2, backend="native"),
            folder / "out",
            references=folder / "kept",
        )
    return folder / "out"


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to spoil."""
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", STEPS)
    return Path(shutil.copytree(made, tmp_path / "out"))


def test_finished_folder_names_its_sources(folder: Path, registry: Registry) -> None:
    report = verify_folder(folder)
    assert (report.problems, report.files) == ((), 6)
    manifest = provenance.read_manifest(folder)
    assert manifest is not None
    assert manifest["registry"]["roots"] == {"v0": registry.root("v0")}
    assert set(manifest["made_with"]) >= {"processor", "versions", "devices"}
    identity = manifest["identity"]
    assert identity["egos"][0][1] == registry.policy("scratch/ippo-d1-s0-v0/robot").sha256
    assert {"env_version", "evaluator_version", "engine", "software", "seed"} <= set(identity)


def test_one_bit_of_any_file_is_found(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        if not path.is_file() or path.name.startswith("."):
            continue
        whole = path.read_bytes()
        for place in (0, len(whole) // 2, len(whole) - 2):
            data = bytearray(whole)
            data[place] ^= 2
            path.write_bytes(bytes(data))
            assert verify_folder(folder).problems, (path.name, place)
        path.write_bytes(whole)
    assert verify_folder(folder).ok


def test_missing_unknown_and_foreign_files_are_reported(folder: Path, tmp_path: Path) -> None:
    (folder / tables.BOUNDS_FILE).unlink()
    assert "bounds.parquet is missing" in verify_folder(folder).problems[0]
    provenance.seal(folder)
    assert verify_folder(folder).ok
    tables.write_json({}, folder / tables.ORDER_FILE)
    assert "order.json is not in the manifest" in verify_folder(folder).problems[0]
    (folder / tables.ORDER_FILE).unlink()
    (folder / "mine.html").write_text("a report of the user's")
    assert verify_folder(folder).ok
    assert "has no manifest.json" in verify_folder(tmp_path).problems[0]


def test_a_received_manifest_cannot_make_us_read_elsewhere(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("x")
    manifest = provenance.read_manifest(folder) or {}
    provenance.write_manifest(folder, {**manifest, "files": {"../secret": "0" * 64}})
    assert "is no file of" in verify_folder(folder).problems[0]


def test_a_received_manifest_commands_no_terminal(
    folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Names, hashes, sources and JSON of a manifest are printed without control characters."""
    evil = "\x1b]0;owned\x07\x9b31m\nverified 9 files\u202e\udcff"
    whole = provenance.read_manifest(folder) or {}
    files, sources = whole["files"], whole["sources"]
    for manifest in (
        {"files": {**files, f"a{evil}": "0"}},
        {"files": {**files, f"../{evil}": "0"}},
        {"files": {**files, tables.SUMMARY_FILE: evil}},
        {"identity": evil},
        {"identity": {**whole["identity"], "egos": [[evil]]}},
        {"sources": {evil: evil}},
        {"sources": {**sources, "files": {evil: evil, str(folder / tables.SUMMARY_FILE): evil}}},
        {"sources": {**sources, "registry": evil}},
        {"sources": {**sources, "releases": {evil: {"policies": {evil: evil}, "entries": {}}}}},
    ):
        provenance.write_manifest(folder, {**whole, **manifest})
        for words in ([], ["--json"]):
            with contextlib.suppress(SystemExit):
                run(["verify", str(folder), *words])
            out = "".join(capfd.readouterr())
            assert out and all(letter.isprintable() or letter == "\n" for letter in out), manifest
            assert "\nverified 9" not in out
            if words:
                json.loads(out)


def reidentified(folder: Path, **changes: Any) -> None:
    """Write another identity into a manifest, consistently, as a sender can."""
    manifest = provenance.read_manifest(folder) or {}
    identity = {**manifest["identity"], **changes}
    job = provenance.identity_digest(identity)
    provenance.write_manifest(folder, {**manifest, "identity": identity, "job": job})


@pytest.mark.parametrize("episodes", [10**6, 2.0, True, -1, "2", None])
def test_a_received_number_takes_no_memory(folder: Path, episodes: Any) -> None:
    reidentified(folder, episodes=episodes)
    tracemalloc.start()
    report = verify_folder(folder)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "other episodes than the manifest" in report.problems[0] and most < 1 << 22


def test_links_in_place_of_files_are_not_followed(folder: Path) -> None:
    """One to a pipe or to `/proc/kmsg` would never end."""
    for name in (tables.SUMMARY_FILE, tables.EPISODES_FILE, provenance.MANIFEST_FILE):
        whole = (folder / name).read_bytes()
        (folder / name).unlink()
        (folder / name).symlink_to("/proc/self/environ")
        assert "no regular file" in verify_folder(folder).problems[0]
        with pytest.raises(ValueError, match="no regular file"):
            check_whole(folder)
        (folder / name).unlink()
        (folder / name).write_bytes(whole)
    assert verify_folder(folder).ok


def test_sealed_table_of_other_episodes_is_found(folder: Path) -> None:
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    forged = table.with_columns(pl.lit("scratch/ippo-d1-s1-v0/robot").alias("ego"))
    for other, problem in (
        (table.head(-1), "rows"),
        (pl.concat([table, table.head(1)]), "rows"),
        (forged, "other egos than the manifest"),
    ):
        tables.write_episodes(other, folder / tables.EPISODES_FILE)
        provenance.seal(folder)
        assert problem in verify_folder(folder).problems[0]


def changed(folder: Path, registry: Registry, factor: float) -> None:
    """Change every return, draw all figures from them, and seal the folder."""
    forger = Forger(folder, registry, random.Random(0), folder)
    forger.scale(pl.lit(value=True), factor)
    forger.close()


def test_forged_figures_are_found(
    folder: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: consistent hashes of invented returns and their figures."""
    changed(folder, registry, 1.00001)
    report = replay_folder(folder, registry, sample=1)
    assert not report.ok and report.differing == 8 and "other values" in report.problems[0]
    monkeypatch.setattr(replay, "processor", lambda: "another")
    elsewhere = replay_folder(folder, registry, sample=1)
    assert elsewhere.ok and not elsewhere.exact and "other processor" in elsewhere.why
    assert (elsewhere.differing, (elsewhere.hidden or 0) > 0) == (8, True)
    changed(folder, registry, 1000)
    assert "return of " in " ".join(replay_folder(folder, registry, sample=1).problems)


def test_equal_bits_pass_on_any_machine(folder: Path, registry: Registry) -> None:
    manifest = provenance.read_manifest(folder) or {}
    for made in (manifest["made_with"], {}, None, [7], {"versions": None, "processor": {}}):
        provenance.write_manifest(folder, {**manifest, "made_with": made})
        report = replay_folder(folder, registry, sample=1)
        assert report.ok and report.exact and report.differing == 0
        assert ("the same bits, though" in report.why) == (made != manifest["made_with"])


def test_references_are_played_again_too(folder: Path, registry: Registry) -> None:
    report = replay_folder(folder, registry, sample=1)
    assert report.references == report.of_references == 36
    forger = Forger(folder, registry, random.Random(0), folder)
    forging.bounds_moved(forger)
    report = replay_folder(folder, registry, sample=1)
    assert not report.ok and "other values" in report.problems[0]
    forging.partner_dropped(forger)
    report = replay_folder(folder, registry, sample=1)
    assert "3 of 4 test partners" in report.unchecked[0]


def test_replay_sample_is_random_and_repeatable(
    folder: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A forger must not know the sample in advance."""
    monkeypatch.setattr(rederive, "derived_problems", lambda *args, **options: [])
    chosen: list[Any] = []

    class Seen(replay.Runner):
        def run(self, chunks: Any, save: Any, meter: Any = None) -> None:
            chosen.append([chunk.tiles for chunk in chunks])
            raise ValueError("seen")

    monkeypatch.setattr(replay, "Runner", Seen)
    monkeypatch.setattr("evaluation.play.tiles.SMALL_JOB", 1)
    # One simulation a tile: no backend makes tiles so small.
    monkeypatch.setattr("evaluation.replay.job.tile_envs_of", lambda backend, manifest: 1)
    for seed in (*[None] * 20, 3, 3):
        with pytest.raises(ValueError, match="seen"):
            replay_folder(folder, registry, sample=1, seed=seed)
    assert len({repr(tiles) for tiles in chosen[:20]}) > 1 and chosen[20] == chosen[21]


def test_every_figure_is_drawn_again(folder: Path, registry: Registry) -> None:
    """Of each kind of file, one number that is another, sealed."""
    manifest = (folder / provenance.MANIFEST_FILE).read_bytes()
    for name in (tables.SUMMARY_FILE, *DERIVED_TABLES):
        path = folder / name
        whole = path.read_bytes()
        if name.endswith(".json"):
            content = tables.read_json(path)
            content["m_test"]["mean"] *= 1.01
            tables.write_json(content, path)
        else:
            table = tables.read_parquet(path)
            last = [name for name, kind in table.schema.items() if kind.is_float()][-1]
            tables.write_parquet(table.with_columns(pl.col(last).fill_null(0) + 0.1), path)
        provenance.seal(folder)
        report = replay_folder(folder, registry)
        assert not report.ok and name in report.problems[0] and not report.episodes, report
        path.write_bytes(whole)
        (folder / provenance.MANIFEST_FILE).write_bytes(manifest)


def test_unplayable_folder_error_has_reason(folder: Path, registry: Registry) -> None:
    manifest = provenance.read_manifest(folder) or {}
    identity = manifest["identity"]
    robot = identity["egos"][0][0]

    def refused(reason: str, cut: Any = None, **changes: Any) -> None:
        other = {"identity": {**identity, **changes}, **(cut or {})}
        provenance.write_manifest(folder, {**manifest, **other})
        with pytest.raises(ValueError, match=reason):
            rebuild_job(Record.read(folder), registry)

    refused("is code, and the folder names it", egos=[["python:evil.py:make", "0"]])
    refused("which no file holds", egos=[["object:Robot-0", "0"]])
    refused("outside the folder", egos=[["/gone/mine.safetensors", "0"]])
    refused("is not here", egos=[[f"{folder}/mine.safetensors", "0"]])
    refused("is not the one that played", egos=[[robot, "0" * 64]])
    refused("env_version differ", env_version=7)
    refused("extra differ", extra=1)
    refused("side_preferences differ", side_preferences={"test": ["p1"]})
    partners = [[*row[:2], "train", *row[3:]] for row in identity["partners"]]
    refused("partners differ", partners=partners)
    for cut in (1, 511, 98304, 10**12, None, "x", True, -1):
        refused("tile_envs is", {"tile_envs": cut})
    refused("max_envs is", {"max_envs": 10**12})
    reidentified(folder, egos=[[robot, "0" * 64]])
    with pytest.raises(ValueError, match="is not the one that played"):
        replay_folder(folder, registry)
    provenance.write_manifest(folder, {**manifest, "max_envs": None})
    with pytest.raises(ValueError, match="max_envs is None"):
        replay_folder(folder, registry)
    (folder / tables.SUMMARY_FILE).write_text("{}")
    with pytest.raises(ValueError, match="is not replayed"):
        replay_folder(folder, registry)
    with pytest.raises(ValueError, match="sample is 0"):
        replay_folder(folder, registry, sample=0)


def test_machine_lists_changed_jax_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    usual = provenance.describe_machine()["settings"]
    assert usual["XLA_FLAGS"] == "--xla_cpu_multi_thread_eigen=false"
    with jax.enable_x64(True):
        assert provenance.describe_machine()["settings"] == usual | {"jax_enable_x64": True}
