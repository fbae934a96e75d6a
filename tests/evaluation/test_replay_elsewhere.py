"""A folder that names another machine, or chooses its tiles, hides no more than replay says."""

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_zoo.shell.main import run
from evaluation.play.how import PlaySettings
from evaluation.replay.replay import replay_folder
from tests.attack import forging
from tests.attack.commands import small_zoo
from tests.attack.forging import Forger
from tests.population.toy_env import ToyEnv, match
from tests.studies import cross_play, evaluate_policies
from zoo.registry import Registry, load_registry

pytestmark = pytest.mark.slow  # each folder is played, and played again
ROBOTS = ["zoo:scratch/ippo-d1-s0-v0/robot", "zoo:scratch/ippo-d1-s1-v0/robot"]
EPISODES = 54


def toy(task: str, backend: str = "native", **_: Any) -> ToyEnv:
    """Return an environment that is quick to compile, with a reward term that was measured."""
    made = ToyEnv(lambda *args: {"reach_target": sum(match(*args).values())})
    made.task, made.backend = task, backend
    return made


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.make", toy)


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    return load_registry(small_zoo(tmp_path_factory.mktemp("zoo")))


@pytest.fixture(scope="module")
def made(zoo: Registry, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Honest folders: of two backends, and a cross-play."""
    home = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assistax_envs.make", toy)
        for backend in ("native", "mjx"):
            how = PlaySettings("scratch", EPISODES, backend=backend)
            evaluate_policies(zoo, ROBOTS, how, home / backend, split="both")
        how = PlaySettings("scratch", 2, backend="native")
        cross_play(zoo, "scratch/*/robot", "scratch/*/human", how, home / "xp")
    return home


@pytest.fixture
def forge(made: Path, zoo: Registry, tmp_path: Path) -> Callable[..., Path]:
    """Return a forged copy of an honest folder."""

    def forge(name: str, change: Callable[[Forger], None]) -> Path:
        folder = Path(shutil.copytree(made / name, tmp_path / name))
        change(Forger(folder, zoo, random.Random(0), folder))
        return folder

    return forge


def raised(forger: Forger, rows: pl.Expr, by: float) -> None:
    """Add to returns and to their term."""
    for name in ("return", "term_reach_target"):
        value = (pl.col(name) + by * rows.cast(pl.Float32)).cast(pl.Float32)
        forger.table = forger.table.with_columns(value.alias(name))


@pytest.mark.parametrize("name", ["native", "mjx", "xp"])
def test_honest_folders_are_the_same(name: str, made: Path, zoo: Registry) -> None:
    report = replay_folder(made / name, zoo, sample=1)
    assert (report.verdict, report.hidden, report.found) == ("same", 0.0, 1.0), report
    assert report.difference == 0 and report.tiles == report.of_tiles == 1
    figures = {"xp": "cross-play mean"}
    assert report.figure == figures.get(name, "M_test")
    summary = json.loads((made / name / "summary.json").read_text())
    kept = summary["cross_play" if name == "xp" else "m_test"]["mean"]
    assert report.value == pytest.approx(kept)


def test_headline_rows_have_headline_mean(made: Path, zoo: Registry, forge: Any) -> None:
    """A change of the headline's rows changes M_test and the cross-play mean by the same amount."""

    def change(forger: Forger) -> None:
        rows = pl.col("ego_team") != pl.col("partner_team")
        raised(forger, rows if forger.is_crossplay else pl.col("side") == "test", 1.0)
        forger.manifest["made_with"] = None
        forger.close()

    for name in ("native", "xp"):
        honest = replay_folder(made / name, zoo)
        report = replay_folder(forge(name, change), zoo)
        assert report.value == pytest.approx(honest.value + 1)
        assert report.difference == pytest.approx(-1)


def test_small_tiles_hide_nothing_on_mjx(zoo: Registry, forge: Any) -> None:
    """The folder says tiles of one, so that two false episodes of 216 were seldom played."""

    def change(forger: Forger) -> None:
        forger.manifest.update(tile_envs=1, max_envs=1)
        rows = pl.col("partner") == forger.table["partner"][-1]
        raised(forger, rows & pl.col("episode").is_in([7, 9]), 20000.0)
        forger.close()

    folder = forge("mjx", change)
    for seed in range(8):
        report = replay_folder(folder, zoo, sample=20, seed=seed)
        assert not report.ok and report.verdict == "differs", report


def test_other_software_confirms_no_raised_figure(
    zoo: Registry, forge: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    """Some episodes are raised, by less than is called forged."""

    def change(forger: Forger) -> None:
        forger.identity["software"] = {**forger.identity["software"], "jax": "0.4.1"}
        raised(forger, pl.col("episode") % 10 == 1, 200.0)
        raised(forger, pl.col("episode") % 2 == 1, 0.1)
        raised(forger, pl.lit(value=True), -0.05)  # as many below as above
        forger.close()

    folder = forge("native", change)
    report = replay_folder(folder, zoo)
    assert report.ok and report.verdict == "cannot be told", report
    assert report.hidden is not None and report.difference is not None
    assert 20 < -report.difference < report.hidden
    with pytest.raises(SystemExit, match="3"):
        run(["replay", str(folder), "--registry", str(zoo.path)])
    printed = capfd.readouterr().out
    assert "cannot be told from another processor" in printed and "the same" not in printed
    assert f"up to {report.hidden:.1f} of it" in printed and "as the folder says" in printed


def test_code_that_a_folder_names_does_not_run(made: Path, zoo: Registry, tmp_path: Path) -> None:
    for name, robot in forging.outside_names(tmp_path).items():
        folder = Path(shutil.copytree(made / "native", tmp_path / name))
        forger = Forger(folder, zoo, random.Random(0), folder)
        forging.rename_robot(forger, robot)
        with pytest.raises(ValueError, match="the folder names it"):
            replay_folder(folder, zoo)
    assert not (tmp_path / forging.MARKER).exists()
