"""Series of episodes: a robot keeps its memory, and its partner does not."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

from evaluation.cast.roster import HostEgo, Member, Roster
from evaluation.figures.summary import summarise_evaluation
from evaluation.play import tiles
from evaluation.play.evaluator import in_order, run_job
from evaluation.play.jobs import Job
from evaluation.play.runner import play
from evaluation.record.columns import validate_episodes
from population.networks.spec import PolicySpec
from tests.evaluation.episode_tables import CONTEXT, recorded
from tests.evaluation.matrix_game import (
    GRU,
    HUMAN,
    PAYOFF,
    ROBOT,
    MatrixGame,
    humans,
    random_roster,
    robots,
    roster,
)


class Counting:
    """Counts the episodes that it remembers, n, and acts n - 1.5: first row 0, then row 1."""

    def __init__(self, spec: PolicySpec) -> None:
        self.spec = spec

    def initial_carry(self, batch_shape: tuple[int, ...]) -> jax.Array:
        return jnp.zeros(batch_shape)

    def act(self, params: Any, carry: jax.Array, obs: jax.Array, first: jax.Array) -> Any:
        count = jnp.where(first, 0.0, carry) + (obs[..., 1] == 0)  # the game's step
        return count, jnp.broadcast_to(
            count[..., None] - 1.5, (*count.shape, self.spec.action_size)
        )


@dataclasses.dataclass(frozen=True)
class CountingSpec(PolicySpec):
    def player(self) -> Counting:
        return Counting(self)


def counting(spec: PolicySpec) -> Roster:
    [member] = (robots if spec.role == "robot" else humans)(0.0).members.values()
    counts = CountingSpec(**dataclasses.asdict(spec))
    return roster(counts, (member,), {"none": np.zeros(1, np.float32)})


def job_of(egos: Roster, partners: Roster | None = None, **changes: Any) -> Job:
    partners = partners or humans(-0.5, 0.5, -0.5, disabilities=("d1", "d2", "d3"))
    options = {"episodes": 6, "sides": dict.fromkeys(partners.ids, "test"), **changes}
    return Job("matrix", 1, "native", egos, partners, **options)


def played(job: Job, max_envs: int = 64) -> pl.DataFrame:
    return in_order(play(MatrixGame(), job, max_envs), job)


def test_robot_remembers_series_and_human_forgets() -> None:
    table = played(job_of(counting(ROBOT), counting(HUMAN), series=3))
    assert sorted(table["place"]) == [1, 1, 2, 2, 3, 3]
    row = (table["place"].to_numpy() > 1).astype(int)
    np.testing.assert_allclose(table["term_payoff"], 4 * PAYOFF[row, 0])
    np.testing.assert_allclose(table["force_peak"], 4 + np.abs(table["place"].to_numpy() - 1.5))
    alone = played(job_of(counting(ROBOT), counting(HUMAN)))
    assert "place" not in alone.columns and set(alone["force_peak"]) == {4.5}


def test_summary_has_the_return_in_each_place(tmp_path: Path) -> None:
    job = job_of(counting(ROBOT), series=3)
    table = run_job(MatrixGame(), job, tmp_path).table
    validate_episodes(table)
    places = summarise_evaluation(recorded(table), CONTEXT).by_place
    assert list(places) == ["1", "2", "3"]
    for place, figure in places.items():
        mean = table.filter(place=int(place))["return"].mean()
        assert (figure.mean, figure.n) == (pytest.approx(mean), 3)
        assert figure.mean_ci is not None
    assert summarise_evaluation(recorded(played(job_of(counting(ROBOT)))), CONTEXT).by_place == {}


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
def test_series_change_only_recurrent_robots() -> None:
    def pair(spec: PolicySpec) -> tuple[pl.DataFrame, pl.DataFrame]:
        egos, partners = random_roster(spec, 2, 1), random_roster(HUMAN, 3, 2)
        together = played(job_of(egos, partners, series=3))
        return together, played(job_of(egos, partners))

    together, apart = pair(ROBOT)
    assert together.drop("place").equals(apart)
    together, apart = pair(GRU)
    begun = (together["place"] == 1).to_numpy()
    change = (together["force_mean"] - apart["force_mean"]).to_numpy()
    assert not change[begun].any() and change[~begun].all()


@pytest.mark.usefixtures("optimised")
def test_values_do_not_depend_on_the_tile(monkeypatch: pytest.MonkeyPatch) -> None:
    job = job_of(random_roster(GRU, 2, 1), random_roster(HUMAN, 3, 2), episodes=8, series=2)
    whole = played(job)
    assert played(job, 4).equals(whole)
    for most in (3, 8):  # a series is never cut
        monkeypatch.setitem(tiles.TILE_ENVS, "native", most)
        assert played(job).equals(whole)
    few = played(dataclasses.replace(job, episodes=4))
    assert few.equals(whole.filter(pl.col("episode") < 4))  # more series extend fewer


class Host:
    """Acts beyond the range from its second episode on."""

    def __init__(self) -> None:
        self.resets: list[int] = []
        self.steps = 0

    def reset(self, rows: int) -> None:
        self.resets.append(rows)
        assert self.steps == 0

    def act(self, obs: np.ndarray) -> np.ndarray:
        self.steps += 1
        return np.full((len(obs), 2), 2.0 if self.steps > 4 else 0.5)


def test_outside_robot_is_reset_per_series() -> None:
    """Clipped numbers are counted by episode."""
    host = Host()
    egos = Roster((HostEgo("host", host),), {"host": Member("host", "0")})
    table = played(job_of(egos, humans(0.5), episodes=6, series=3))
    # Two series at once, of three episodes of four steps.
    assert (host.resets, host.steps) == ([2], 12)
    assert set(table.select("place", "clipped").rows()) == {(1, 0.0), (2, 1.0), (3, 1.0)}


def test_partners_begin_series_at_different_starts() -> None:
    names = [f"matrix/hand-d1-s{seed}-v0/human" for seed in range(60)]
    job = job_of(robots(0.5), episodes=15, series=5, preferences=("p1", "p5", "p9"))
    order = job.order(names, 15)
    assert all(sorted(row) == list(range(15)) for row in order)
    assert all(set(row[5:10]) == set(range(5, 10)) for row in order)
    assert {len(set(order[:, place])) for place in range(15)} == {5}
    wishes = job.preferences_of(names, range(15)).reshape(60, 3, 5)
    assert all(len(set(series)) == 1 for row in wishes for series in row)
    assert all(sorted(row[:, 0]) == ["p1", "p5", "p9"] for row in wishes)


def test_series_are_of_identity_only_if_used() -> None:
    job = job_of(robots(0.5))
    assert "series" not in job.identity()
    assert job_of(robots(0.5), series=3).identity() == {**job.identity(), "series": 3}
    for series in (4, 0):
        with pytest.raises(ValueError, match=f"series is {series} of 6 episodes; give 1 or more"):
            job_of(robots(0.5), series=series)
