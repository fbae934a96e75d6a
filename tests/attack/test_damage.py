"""Five thousand damaged files of every kind: refused in a line, found by `verify`, or made again.

A registry, a lock, a shard and a sealed folder have hashes, so that every change must be found. A
policy file and a run folder are their owner's alone: there the damage must not do harm.
"""

import contextlib
import functools
import json
import shutil
import sys
from collections.abc import Callable, Generator
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from assistax_base.digest import canonical_json
from assistax_base.errors import ZooError
from assistax_workshop.press.trained_runs import read_run
from evaluation.play.evaluator import run_job
from evaluation.record import manifest as provenance
from evaluation.record.verification import verify_folder
from evaluation.report import write_report
from population.networks.tensors import flatten
from population.runs.checkpoints import Checkpoints
from population.runs.folder import RunFolder
from tests.attack.damage import BYTES, damaged, tensors
from tests.attack.ledger import Ledger, attack
from tests.attack.watch import Watch
from tests.evaluation.matrix_game import MatrixGame
from tests.evaluation.test_evaluator import make_job, mixed_job, unfinished
from zoo.lock import read_lock
from zoo.locking import make_lock, write_lock
from zoo.parameters.storage import load_stacks, read_policy_file, write_policy_file
from zoo.registry import Registry, load_registry
from zoo.verify import verify

pytestmark = pytest.mark.attack
REFUSALS = (ZooError, ValueError, OSError)  # what the command line says in one line


def told(error: BaseException) -> None:
    text = str(error)
    assert len(text) < 3000 and "\x1b" not in text, text[:200]


@contextlib.contextmanager
def refusable() -> Generator[None]:
    """Let a refusal pass if it is told well."""
    try:
        yield
    except REFUSALS as error:
        told(error)


def spoil(
    ledger: Ledger, path: Path, count: int, check: Callable[[bytes, bytes], None], name: str
) -> None:
    """Damage one file in many ways, one at a time; `check` is given the old and the new bytes."""
    whole = path.read_bytes()
    watch = Watch([path.parent, Path("/tmp")])
    for trial in range(ledger.wanted(count)):
        data = damaged(ledger.random, whole, path.suffix)
        path.write_bytes(data)
        with ledger.trial(f"{name} {trial} {sys.getsizeof(data)}"):
            with refusable():
                check(whole, data)
            assert not watch.outside, watch.outside
    watch.on = False
    path.write_bytes(whole)


def copied(registry_path: Path, folder: Path) -> Registry:
    shutil.copytree(registry_path.parent, folder / "zoo")
    return load_registry(folder / "zoo" / "registry.json")


def test_registries(registry_path: Path, tmp_path: Path) -> None:
    true = copied(registry_path, tmp_path)

    def check(whole: bytes, data: bytes) -> None:
        read = load_registry(true.path)
        if read.data != true.data:
            assert not verify(read).ok, "a changed registry passes `verify`"

    with attack("damaged registries") as ledger:
        spoil(ledger, true.path, 1200, check, "registry")


def test_locks(registry_path: Path, tmp_path: Path) -> None:
    registry = load_registry(registry_path)
    path = tmp_path / "mine.json"
    true = make_lock(registry, registry.policies)
    write_lock(true, path)

    def check(whole: bytes, data: bytes) -> None:
        assert read_lock(path) == true, "a changed lock is read"

    with attack("damaged locks") as ledger:
        spoil(ledger, path, 600, check, "lock")


def test_shards(registry_path: Path, tmp_path: Path) -> None:
    registry = copied(registry_path, tmp_path)
    entry = registry.policies[0]

    def check(whole: bytes, data: bytes) -> None:
        load_stacks(registry, [entry])
        assert data == whole, "a changed shard is loaded"

    with attack("damaged shards") as ledger:
        spoil(ledger, registry.shard_path(entry.shard), 1000, check, "shard")


def test_policy_files(registry_path: Path, tmp_path: Path) -> None:
    registry = load_registry(registry_path)
    entry = registry.policies[0]
    (stack,) = load_stacks(registry, [entry])
    leaves = {name: value[0] for name, value in flatten(stack.params).items()}
    path = tmp_path / "policy.safetensors"
    write_policy_file(path, entry.spec, leaves)

    def check(whole: bytes, data: bytes) -> None:
        leaves = flatten(read_policy_file(path).params)
        assert all(np.isfinite(value).all() for value in leaves.values())

    with attack("damaged policies") as ledger:
        spoil(ledger, path, 800, check, "policy")


def test_run_folders(made: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(made / "run", tmp_path / "run"))
    config = RunFolder(run).config()

    def check(whole: bytes, data: bytes) -> None:
        def resume() -> None:
            folder = RunFolder(run)
            folder.config()
            folder.finished(config)
            folder.read_metrics(99)

        for read in (resume, lambda: read_run(run)):
            with refusable():
                read()

    with attack("damaged run folders") as ledger:
        names = ("teams.json", "config.json", "robot.safetensors", "metrics.parquet")
        for name in names:
            spoil(ledger, run / name, 125, check, name)


def test_results(made: Path, tmp_path: Path) -> None:
    """A damaged file is found by `verify`, and no page is made from it.

    Sealed anew, as whoever sends a folder can, it makes no harm.
    """
    result = Path(shutil.copytree(made / "result", tmp_path / "result"))
    manifest = (result / provenance.MANIFEST_FILE).read_bytes()

    def check(path: Path, whole: bytes, data: bytes) -> None:
        # The manifest, which no other file has a hash of, may be written with other spaces.
        may_be_spaced = path.name == provenance.MANIFEST_FILE
        changed = data != whole and not (may_be_spaced and _same_json(whole, data))
        assert bool(verify_folder(result).problems) == changed
        with refusable():
            write_report(result, tmp_path / "page.html")
            assert not changed, "a page was made from a damaged file"

    def sealed(whole: bytes, data: bytes) -> None:
        try:
            provenance.seal(result)
            verify_folder(result)
            write_report(result, tmp_path / "page.html")
            assert "<script>alert(1)" not in (tmp_path / "page.html").read_text()
        finally:
            (result / provenance.MANIFEST_FILE).write_bytes(manifest)

    files = [path for path in sorted(result.iterdir()) if path.is_file()]
    files = [path for path in files if not path.name.startswith(".") and path.suffix != ".png"]
    with attack("damaged results") as ledger:
        for path in files:
            spoil(ledger, path, 50, functools.partial(check, path), path.name)
            if path.name != provenance.MANIFEST_FILE:
                spoil(ledger, path, 30, sealed, f"sealed {path.name}")


def _same_json(left: bytes, other: bytes) -> bool:
    try:
        # In Python 1 is True.
        return canonical_json(json.loads(left)) == canonical_json(json.loads(other))
    except ValueError:
        return False


def test_parts_and_tables(tmp_path: Path) -> None:
    """What is damaged is played again; the answer is the same."""
    job = make_job()
    true = run_job(MatrixGame(), job, tmp_path / "whole").table
    run_job(MatrixGame(), job, tmp_path / "finished")
    unfinished(tmp_path / "parts")
    mixed = run_job(MatrixGame(), mixed_job(), tmp_path / "mixed", max_envs=7).table
    with attack("damaged parts and tables") as ledger:
        for trial in range(ledger.wanted(100)):
            name, expected = ledger.random.choice((("finished", true), ("parts", mixed)))
            folder = Path(shutil.copytree(tmp_path / name, tmp_path / f"{name}{trial}"))
            files = [path for path in folder.rglob("*.*") if path.suffix in (".json", ".parquet")]
            path = ledger.random.choice(files)
            path.write_bytes(damaged(ledger.random, path.read_bytes(), path.suffix))
            with ledger.trial(f"{name} {path.name}"):
                again = job if name == "finished" else mixed_job()
                try:
                    assert run_job(MatrixGame(), again, folder).table.equals(expected)
                except REFUSALS as error:
                    assert path.name == provenance.MANIFEST_FILE, error
            shutil.rmtree(folder)


# Orbax's loops say so after a read that failed.
@pytest.mark.filterwarnings("ignore:Exception ignored in", "ignore:the checkpoint of update")
def test_checkpoints(tmp_path: Path) -> None:
    """The state is one that was saved, to the bit, or there is none."""
    states = {step: {"w": jnp.arange(200.0) * step, "step": jnp.asarray(step)} for step in (1, 2)}
    saved = Checkpoints(tmp_path / "whole")
    for step, state in states.items():
        saved.save(step, state)
    saved.close()
    with attack("damaged checkpoints") as ledger:
        for trial in range(ledger.wanted(200)):
            folder = Path(shutil.copytree(tmp_path / "whole", tmp_path / str(trial)))
            files = [path for path in folder.rglob("*") if path.is_file() and path.stat().st_size]
            path = ledger.random.choice(files)
            path.write_bytes(ledger.random.choice(BYTES)(ledger.random, path.read_bytes()))
            with ledger.trial(f"checkpoint {path.relative_to(folder)}"):
                _restore(folder, states)
            shutil.rmtree(folder)


def _restore(folder: Path, states: dict[int, dict]) -> None:
    with refusable():
        with contextlib.closing(Checkpoints(folder)) as checkpoints:
            restored = checkpoints.restore_latest(states[1])
        assert restored is not None
        expected = states[restored[0]]
        assert all(np.array_equal(restored[1][name], expected[name]) for name in expected)


def test_the_harness_finds_what_it_looks_for(registry_path: Path, tmp_path: Path) -> None:
    """Planted: a loader that believes every shard, and a `verify` that believes every file."""
    registry = copied(registry_path, tmp_path)
    path = registry.shard_path(registry.policies[0].shard)
    ledger = Ledger("planted")

    def believe(whole: bytes, data: bytes) -> None:
        assert data == whole

    spoil(ledger, path, 100, believe, "shard")
    assert len(ledger.failures) == ledger.trials
    assert tensors(ledger.random, path.read_bytes()) != path.read_bytes()
