"""What is sent to Weights & Biases is what the metrics hold; a stand-in takes it here."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import polars as pl
import pytest

from population.team_training import _log
from population.tensorboard import scalars
from population.train import train
from population.wandb_runs import WandbRuns
from tests.population.test_train import CONFIG
from tests.population.toy_env import ToyEnv, match


class Run:
    """Keeps what it is given."""

    def __init__(self, **given: Any) -> None:
        self.given, self.logged, self.finished = given, [], False

    def log(self, values: dict[str, float], step: int) -> None:
        self.logged.append((step, values))

    def finish(self) -> None:
        self.finished = True


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[Run]:
    made: list[Run] = []

    def init(**given: Any) -> Run:
        made.append(Run(**given))
        return made[-1]

    monkeypatch.setitem(sys.modules, "wandb", SimpleNamespace(init=init))
    return made


def test_every_member_has_a_run_with_its_metrics(runs: list[Run], tmp_path: Path) -> None:
    log = _log(CONFIG, tmp_path / "run", "wandb:study")
    train(CONFIG, ToyEnv(match), tmp_path / "run", progress=log)
    log.catch_up()
    log.close()
    table = pl.read_parquet(tmp_path / "run" / "metrics.parquet")
    assert len(runs) == len(CONFIG.members) == len({run.given["id"] for run in runs})
    for member, run in enumerate(runs):
        assert run.finished and run.given["project"] == "study"
        assert run.given["name"].endswith(CONFIG.members[member].label)
        rows = table.filter(member=member)
        assert [step for step, _ in run.logged] == rows["steps"].to_list()
        for (_, sent), row in zip(run.logged, rows.iter_rows(named=True), strict=True):
            assert sent.pop("speed/steps_per_second") > 0
            assert sent == pytest.approx(scalars(row))
        assert "episode/return" in sent and not any("seed" in name for name in sent)


def test_a_run_that_goes_on_is_the_same_there(runs: list[Run], tmp_path: Path) -> None:
    for folder in ("run", "run", "other"):
        WandbRuns(CONFIG, tmp_path / folder, "study")
    ids = [run.given["id"] for run in runs]
    n = len(CONFIG.members)
    assert ids[:n] == ids[n : 2 * n] and not {*ids[:n]} & {*ids[2 * n :]}
    assert runs[0].given["resume"] == "allow"


def test_without_the_package_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(ValueError, match=r"assistax-zoo\[wandb\]"):
        WandbRuns(CONFIG, tmp_path, "study")
