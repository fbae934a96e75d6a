"""Folders whose hashes all fit and whose figures are false: does one pass `verify` and `replay`?

A stranger has the registry and this software. Episodes are those of published robots and humans at
their full length. What was simulated once is not simulated again for the same tile of the same job,
of which a digest says all: that is what makes hundreds of replays quick.
"""

import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_base.errors import ZooError
from assistax_envs.env import Env
from evaluation.play.how import PlaySettings
from evaluation.play.jobs import Job
from evaluation.play.runner import Runner
from evaluation.play.tiles import Chunk
from evaluation.record.verification import check_sources, verify_folder
from evaluation.replay import rederive, replay
from evaluation.replay.replay import ReplayReport, replay_folder
from tests.attack import forging
from tests.attack.ledger import attack
from tests.studies import cross_play, evaluate_policies
from zoo.registry import Registry, load_registry

pytestmark = pytest.mark.attack
REFUSALS = (ZooError, ValueError, OSError)
ROBOTS = [f"scratch/ippo-d1-s{seed}-v1/robot" for seed in (0, 1, 2, 3)]
HUMANS = "scratch/ippo-d[239]-s[0-2]-v1/human"
PLAYING = 600.0  # seconds of a trial: programs are compiled, and episodes are a thousand steps
SETTINGS = PlaySettings("scratch", 6, backend="fused")


class Remembering(Runner):
    """Plays, and remembers what it played in this process."""

    seen: dict[Any, pl.DataFrame] = {}  # noqa: RUF012

    def __init__(self, env: Any, job: Job) -> None:
        super().__init__(env, job)
        self._digest = job.digest()

    def run(
        self, chunks: Any, save: Callable[[Chunk, pl.DataFrame], None], meter: Any = None
    ) -> None:
        for chunk in chunks:
            key = self._digest, repr(chunk.tiles)
            if key not in self.seen:
                super().run([chunk], lambda _, rows, key=key: self.seen.update({key: rows}))
            save(chunk, self.seen[key])


@pytest.fixture(scope="module")
def zoo() -> Registry:
    return load_registry()


@pytest.fixture(scope="module")
def honest(zoo: Registry, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two evaluations with the same partners, and a cross-play."""
    home = tmp_path_factory.mktemp("honest")
    options: dict[str, Any] = {"split": "both", "partners": HUMANS, "references": home / "kept"}
    evaluate_policies(zoo, ROBOTS[:2], SETTINGS, home / "evaluation", **options)
    evaluate_policies(zoo, ROBOTS[2:], SETTINGS, home / "better", **options)
    cross_play(zoo, ROBOTS, HUMANS, SETTINGS, home / "crossplay")
    return home


@pytest.fixture(autouse=True)
def remembering(monkeypatch: pytest.MonkeyPatch) -> None:
    """Play what was not played yet; what is called `mjx` is the physics of the honest folders."""

    def make(task: str, *, backend: str, version: int | None = None) -> Any:
        made = Env(task, "fused" if backend == "mjx" else backend, version=version)
        made.backend = backend
        return made

    monkeypatch.setattr(replay, "Runner", Remembering)
    monkeypatch.setattr("assistax_envs.make", make)


def judged(folder: Path, zoo: Registry) -> ReplayReport | None:
    """Return what a stranger is told, or None where the folder is refused."""
    try:
        if not verify_folder(folder).ok or check_sources(folder, zoo.path).problems:
            return None
        return replay_folder(folder, zoo, sample=10**6)
    except REFUSALS as error:
        assert len(str(error)) < 3000, str(error)[:200]
        return None


def passes(report: ReplayReport | None, true: ReplayReport, *, undecided: bool = True) -> bool:
    """Return whether nothing that is false of a folder was said, and whether it was confirmed.

    `undecided` says whether it passes too if it cannot be told from another processor.
    """
    told = report is not None and (undecided or report.verdict != "cannot be told")
    return told and report.ok and report.unchecked == true.unchecked


@pytest.mark.parametrize("of", ["evaluation", "crossplay"])
def test_no_false_figure_passes(honest: Path, zoo: Registry, tmp_path: Path, of: str) -> None:
    kinds = forging.EVALUATION if of == "evaluation" else forging.CROSSPLAY
    true = judged(honest / of, zoo)
    assert true is not None and true.ok and true.exact, true
    with attack(f"forged folders: {of}", PLAYING) as ledger:
        count = ledger.wanted(12 * len(kinds)) if of == "evaluation" else ledger.wanted(96)
        for trial in range(count):
            kind = kinds[trial % len(kinds)]
            rng = random.Random(f"{of} {trial}")
            with ledger.trial(f"{getattr(kind, '__name__', kind)} {trial}"):
                place = tmp_path / f"{of}{trial}"
                folder = forging.forged(
                    honest / of, place, kind, zoo, rng=rng, better=honest / "better"
                )
                undecided = kind not in forging.UNDECIDED
                report = judged(folder, zoo)
                assert not passes(report, true, undecided=undecided), "a false figure passes"
                assert not (tmp_path / forging.MARKER).exists(), "a command ran"


def test_replay_without_redrawn_figures_is_caught(
    honest: Path, zoo: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: the derivation is off, and a changed summary passes."""
    true = judged(honest / "evaluation", zoo)
    assert true is not None
    more = {"rng": random.Random(0), "better": honest / "better"}
    folder = forging.forged(honest / "evaluation", tmp_path / "out", forging.field, zoo, **more)
    assert not passes(judged(folder, zoo), true)
    monkeypatch.setattr(rederive, "derived_problems", lambda *args, **options: [])
    assert passes(judged(folder, zoo), true)


OTHER = """
import sys
from pathlib import Path
from evaluation.play.how import PlaySettings
from tests.studies import evaluate_policies
from zoo.registry import load_registry
zoo, home = load_registry(), Path(sys.argv[1])
for trial in range(int(sys.argv[2])):
    robot = f"scratch/{('ippo', 'mappo')[trial % 2]}-d{1 + trial % 9}-s{trial % 3}-v1/robot"
    evaluate_policies(
        zoo, [robot], PlaySettings("scratch", 6, 200 + trial, ("fused", "native")[trial == 7]),
        home / str(trial), split="both", partners="scratch/*-d[1-9]-s7-v1/human",
        include_own=True, references=home / "kept",
    )
"""


def test_honest_folders_of_another_processor_pass(zoo: Registry, tmp_path: Path) -> None:
    """Played without fused multiply-adds and with half the vectors, as the XLA option has it."""
    with attack("honest folders of another processor", PLAYING) as ledger:
        count = ledger.wanted(20)
        words = [sys.executable, "-c", OTHER, str(tmp_path), str(count)]
        environment = {**os.environ, "XLA_FLAGS": "--xla_cpu_max_isa=AVX"}
        subprocess.run(words, env=environment, check=True)
        for trial in range(count):
            with ledger.trial(f"honest {trial}"):
                report = judged(tmp_path / str(trial), zoo)
                assert report is not None and report.ok, report
                assert report.differing and not report.exact, report
                assert report.verdict in ("within noise", "cannot be told"), report
