"""The luck of the starts: does M_test's interval hold it?

One robot plays the episodes of many seeds with the test partners, once with starts of each
partner's own and once, as tables of before November 2026, with starts that all partners share. A
seed's M_test, with its interval, is what `evaluate --seed` would print.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from evaluation.figures.bootstrap import Estimate, estimate
from evaluation.play.how import default_episodes
from evaluation.play.jobs import Job
from evaluation.play.runner import play
from evaluation.record.record import lay_out

REPETITIONS = 2000  # of drawn partners and starts


@dataclasses.dataclass(frozen=True)
class Luck:
    """What seeds of the episodes do to M_test, and what its interval says of that."""

    starts: str  # "own" or "common"
    resampled: bool  # whether the interval resamples starts that are common
    sd: float  # of M_test over seeds: the luck of the starts
    half_width: float  # of the 95% interval, mean over seeds
    held: float  # share of the seeds whose interval holds the mean over all seeds
    covered: float | None  # share of the intervals of drawn partners and starts that hold it


def measure_luck(task: str, robot: str, seeds: int, *, backend: str = "auto") -> list[Luck]:
    """Return the luck of own and of common starts, for one robot of the zoo.

    Args:
        task: Task.
        robot: Id of a robot.
        seeds: How many seeds' episodes are played.
        backend: Physics.
    """
    from assistax_zoo import open_zoo
    from evaluation.cast.cast import Cast, choose_partners
    from evaluation.cast.egos import read_egos
    from evaluation.play.how import How
    from evaluation.play.study import make_job

    registry, episodes = open_zoo().registry, default_episodes(task)
    split, partners = choose_partners(registry, task, None, None)
    robots = read_egos([robot], registry, task)
    cast = Cast.of(registry, task=task, robots=robots, humans=partners, split=split)
    how = How(task, episodes * seeds, backend=backend)
    env, job = make_job(how, cast.robots, cast.humans, cast.sides, cast.version)
    if split.preferences:
        job = job.with_side_preferences(split.preferences)
    returns = {
        own: _returns(env, dataclasses.replace(job, own_episodes=own)) for own in (True, False)
    }
    blocks = {own: np.stack(np.split(part, seeds, axis=2)) for own, part in returns.items()}
    return [
        _luck("own", blocks[True], resampled=False),
        _luck("common", blocks[False], resampled=True),
        _luck("common", blocks[False], resampled=False),
    ]


def _returns(env: object, job: Job) -> np.ndarray:
    """Play a job and return its returns [S, P, K]."""
    return lay_out(play(env, job, 32768)).values


def _luck(starts: str, blocks: np.ndarray, *, resampled: bool) -> Luck:
    """Judge intervals of blocks [seeds, S, P, K] of episodes."""
    figures = [_estimate(block, resampled) for block in blocks]
    truth = float(np.mean([figure.mean for figure in figures]))
    ends = np.array([figure.mean_ci for figure in figures])
    covered = None
    if starts == "own":
        drawn = [_holds(_estimate(block, resampled), truth) for block in _drawn(blocks)]
        covered = float(np.mean(drawn))
    return Luck(
        starts=starts,
        resampled=resampled,
        sd=float(np.std([figure.mean for figure in figures], ddof=1)),
        half_width=float(np.ptp(ends, axis=1).mean() / 2),
        held=float(np.mean([_holds(figure, truth) for figure in figures])),
        covered=covered,
    )


def _drawn(blocks: np.ndarray) -> Iterator[np.ndarray]:
    """Draw evaluations [S, P, K]: partners with replacement, each with one seed's episodes.

    Their truth is the mean over all partners and episodes that were played.
    """
    rng = np.random.default_rng(0)
    seeds, _, partners, _ = blocks.shape
    for _ in range(REPETITIONS):
        block = (
            rng.integers(seeds, size=partners),
            slice(None),
            rng.integers(partners, size=partners),
        )
        yield blocks[block].swapaxes(0, 1)


def _estimate(returns: np.ndarray, resampled: bool) -> Estimate:
    return estimate(returns, common_starts=resampled)


def _holds(figure: Estimate, truth: float) -> bool:
    return figure.mean_ci is not None and figure.mean_ci[0] <= truth <= figure.mean_ci[1]
