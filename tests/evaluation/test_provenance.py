"""A folder's figures traced to bytes: a change is found, and a sample can be played again."""

import json
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_zoo.main import run
from evaluation import provenance, replay, tables
from evaluation.provenance import verify_folder
from evaluation.replay import replay_folder
from evaluation.studies import Settings, evaluate_policies
from tests import untrained
from zoo.registry import Registry, load_registry

STEPS = 20
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
            Settings("scratch", 2, backend="native"),
            folder / "out",
            references=folder / "kept",
        )
    return folder / "out"


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to spoil."""
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", STEPS)
    return Path(shutil.copytree(made, tmp_path / "out"))


def test_a_finished_folder_is_whole_and_names_what_it_depends_on(
    folder: Path, registry: Registry
) -> None:
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
    """Of every file, at its beginning, middle and end."""
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


def test_missing_unknown_and_foreign_files_are_told(folder: Path, tmp_path: Path) -> None:
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


def reidentified(folder: Path, **changes: Any) -> None:
    """Write another identity into a manifest, consistently, as whoever sends a folder can."""
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
            provenance.check_whole(folder)
        (folder / name).unlink()
        (folder / name).write_bytes(whole)
    assert verify_folder(folder).ok


def test_missing_and_doubled_rows_are_found(folder: Path) -> None:
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    for rows in (table.head(-1), pl.concat([table, table.head(1)])):
        tables.write_episodes(rows, folder / tables.EPISODES_FILE)
        provenance.seal(folder)
        assert "rows" in verify_folder(folder).problems[0]


def test_a_table_of_other_policies_is_found_though_its_hash_is_right(folder: Path) -> None:
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    other = table.with_columns(pl.lit("scratch/ippo-d1-s1-v0/robot").alias("ego"))
    tables.write_episodes(other, folder / tables.EPISODES_FILE)
    provenance.seal(folder)
    assert "other egos than the manifest" in verify_folder(folder).problems[0]


def test_a_sample_played_again_is_the_same_to_the_last_bit(
    folder: Path, registry: Registry
) -> None:
    report = replay_folder(folder, registry, sample=1)
    assert report.ok and report.exact, report
    assert (report.episodes, report.differing) == (8, 0)


def changed(folder: Path, factor: float) -> None:
    """Change every return, and seal the folder as if it had been written so."""
    table = tables.read_episodes(folder / tables.EPISODES_FILE)
    tables.write_episodes(
        table.with_columns(pl.col("return") * factor), folder / tables.EPISODES_FILE
    )
    provenance.seal(folder)


def test_figures_that_nobody_played_are_found(
    folder: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: consistent hashes over returns that are a millionth, or a half, too high."""
    changed(folder, 1.000001)
    assert not replay_folder(folder, registry).ok
    monkeypatch.setattr(replay.provenance, "processor", lambda: "another")
    elsewhere = replay_folder(folder, registry)
    assert elsewhere.ok and not elsewhere.exact and "other processor" in elsewhere.why
    changed(folder, 1.5)
    assert not replay_folder(folder, registry).ok


def test_what_cannot_be_replayed_says_why(folder: Path, registry: Registry) -> None:
    manifest = provenance.read_manifest(folder) or {}
    identity = manifest["identity"]
    code = {**identity, "egos": [["python:evil.py:make", "0"]]}
    with pytest.raises(ValueError, match="is code, and the folder names it"):
        replay._rebuild(code, registry, run_code=False)
    other = {**identity, "egos": [[identity["egos"][0][0], "0" * 64]]}
    provenance.write_manifest(
        folder, {**manifest, "identity": other, "job": provenance.identity_digest(other)}
    )
    with pytest.raises(ValueError, match="egos differ"):
        replay_folder(folder, registry)
    provenance.write_manifest(folder, {**manifest, "max_envs": None})
    with pytest.raises(ValueError, match="names no job"):
        replay_folder(folder, registry)
    (folder / tables.SUMMARY_FILE).write_text("{}")
    with pytest.raises(ValueError, match="is not replayed"):
        replay_folder(folder, registry)
    with pytest.raises(ValueError, match="sample is 0"):
        replay_folder(folder, registry, sample=0)


def test_the_commands_say_what_they_found(
    folder: Path, registry: Registry, capfd: pytest.CaptureFixture[str]
) -> None:
    given = ["--registry", str(registry.path)]
    assert run(["verify", str(folder)]) == 0
    assert "verified 6 files" in capfd.readouterr().out
    assert run(["replay", str(folder), *given]) == 0
    assert "8 episodes" in capfd.readouterr().out
    changed(folder, 1.5)
    with pytest.raises(SystemExit, match="1"):
        run(["replay", str(folder), *given, "--json"])
    assert json.loads(capfd.readouterr().out)["differing"] == 8
    (folder / tables.SUMMARY_FILE).write_text("{}")
    with pytest.raises(SystemExit, match="1"):
        run(["verify", str(folder), "--json"])
    assert "summary.json" in json.loads(capfd.readouterr().out)["problems"][0]
