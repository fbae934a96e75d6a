"""Which numbers of persons matter: shares of variance with known answers, and surfaces by hand."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from assistax_envs.persons.rows import PARAMETERS, index, persons
from assistax_zoo.shell.main import run
from evaluation.figures.by_parameter import (
    Outcomes,
    effects,
    outcomes,
    summarise_parameters,
    surface,
)
from evaluation.plots.persons import person_panels
from evaluation.record.record import Record
from evaluation.record.tables import write_episodes
from tests.evaluation.episode_tables import episode_table, teams

TASK = "gentle_scratch"


def outcomes_of(count: int = 1000, *, slope: float = 1.0, noise: float = 0.0, seed: int = 0):
    """Return persons whose return is their strength's rank, and luck; success is luck."""
    rows, rng = persons(TASK)[:count], np.random.default_rng(seed)
    strength = rows[:, index(TASK)["strength"]].astype(float)
    rank = (strength - strength.mean()) / strength.std()
    values = {
        "return": slope * rank + noise * rng.normal(size=count),
        "success": rng.integers(0, 5, count) / 4,
    }
    return Outcomes(TASK, rows, values, 4 * count, 1)


def test_effect_of_one_number_is_found() -> None:
    ordered, chance = effects(outcomes_of(noise=1.0), "return")
    first, second = ordered[:2]
    assert first.parameter == "strength" and len(ordered) == len(PARAMETERS[TASK])
    # Half of the variance is the number's; five bins of a uniform number hold 1 - 1/25 of that.
    assert first.share == pytest.approx(0.48, abs=0.04)
    assert first.share_ci[0] < 0.48 < first.share_ci[1]
    assert second.share < chance < 0.03 < first.share_ci[0]
    assert first.low_to_high == pytest.approx(2 * 1.39, abs=0.3)  # means of the outer fifths
    assert first.low_to_high_ci[0] > 2.0


def test_luck_alone_is_no_effect() -> None:
    shares = []
    for seed in range(10):
        ordered, chance = effects(outcomes_of(seed=seed), "success", resamples=200, seed=seed)
        shares += [effect.share for effect in ordered]
        assert ordered[0].share_ci[0] < 0.005
        assert sum(effect.share > chance for effect in ordered) <= 2
    assert abs(np.mean(shares)) < 0.001  # no bias, unlike the plain share, which is 0.4%


@pytest.mark.slow
def test_intervals_cover_the_share_that_is_true() -> None:
    covered = 0
    for seed in range(40):
        of = outcomes_of(400, noise=2.0, seed=seed)
        ordered, _ = effects(of, "return", resamples=400, seed=seed)
        [strength] = [effect for effect in ordered if effect.parameter == "strength"]
        covered += strength.share_ci[0] <= 0.96 * 0.2 <= strength.share_ci[1]
    assert covered >= 34  # of 40, where 38 are expected


def test_surface_has_means_and_counts() -> None:
    of = outcomes_of(400)
    cells = surface(of, ("strength", "tremor"), bins=4)
    place = index(TASK)
    strength, tremor = (of.rows[:, place[name]] for name in ("strength", "tremor"))
    assert np.sum(cells.count) == 400
    assert len(cells.x_edges) == 5 and len(cells.y_edges) == 4  # two fifths have no tremor
    inside = (strength < cells.x_edges[1]) & (tremor < cells.y_edges[1])
    assert cells.count[0][0] == inside.sum() > 20
    assert cells.values["return"][0][0] == pytest.approx(of.values["return"][inside].mean())
    lowest, highest = (row[0] for row in np.array(cells.values["return"], float)[[0, 3]])
    assert lowest < highest
    assert json.loads(json.dumps(cells.values)) == cells.values


@pytest.mark.parametrize(
    ("count", "over", "message"),
    [
        (100, ("strength", "charm"), "parameter is 'charm'; allowed are strength"),
        (100, ("strength", "strength"), "over strength twice"),
        (19, (), "19 persons in 5 bins"),
    ],
)
def test_unfit_persons_and_numbers_are_refused(count, over, message) -> None:
    with pytest.raises(ValueError, match=message):
        surface(outcomes_of(count), over) if over else effects(outcomes_of(count), "return")


def test_cell_without_persons_is_none() -> None:
    cells = surface(outcomes_of(24), ("strength", "pace"), bins=12)
    empty = [(x, y) for x, row in enumerate(cells.count) for y, n in enumerate(row) if n == 0]
    assert empty and all(cells.values["return"][x][y] is None for x, y in empty)


NETWORK = "gentle_scratch/ippo-d1-s0-v1/human"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with 40 persons, two robots, and one partner that is no person."""
    partners = [f"gentle_scratch/person-{number:05d}-v1/human" for number in range(40)]
    returns = np.random.default_rng(0).normal(100.0, 30.0, (2, 41, 2))
    table = episode_table(returns, ["a", "b"], teams(41), ["test"] * 41)
    old = table["partner"].unique(maintain_order=True)
    names = dict(zip(old, [*partners, NETWORK], strict=True))
    table = table.with_columns(pl.col("partner").replace_strict(names))
    write_episodes(table, tmp_path / "episodes.parquet")
    return tmp_path


def test_a_folder_is_read_person_by_person(folder: Path) -> None:
    record = Record.read(folder)
    of = outcomes(record)
    np.testing.assert_array_equal(of.rows, persons(TASK)[:40])
    somebody = record.table.filter(partner="gentle_scratch/person-00007-v1/human")
    assert of.values["return"][7] == pytest.approx(np.mean(somebody["return"].to_list()))
    assert of.egos == 2 and of.episodes == record.table.height - record.table.height // 41
    summary = summarise_parameters(record, ("strength", "pace"), most=3)
    assert [len(matter["parameters"]) for matter in summary["matter"].values()] == [3, 3]
    assert len(person_panels(summary, caption="").axes) == 4
    write_episodes(record.table.filter(partner=NETWORK), folder / "episodes.parquet")
    with pytest.raises(ValueError, match="no person among its 1 partners"):
        outcomes(Record.read(folder))


def test_command_notes_and_draws(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    drawn = folder / "persons.png"
    assert run(["persons", str(folder), "--over", "strength,pace", "--out", str(drawn)]) == 0
    printed = capfd.readouterr().out
    assert "40 persons" in printed and "mean return over strength (down) and pace" in printed
    assert drawn.read_bytes().startswith(b"\x89PNG")
    assert run(["persons", str(folder), "--json"]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert summary["persons"] == 40 and set(summary["matter"]) == {"return", "success"}
    assert run(["persons", str(folder), "--over", "strength"]) == 1
    assert "name two or none" in capfd.readouterr().err
