"""Intervals against direct resampling, and their coverage on data with a known truth."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.stats

from evaluation.figures import bootstrap
from evaluation.figures.bootstrap import Estimate


def crossed(
    rng: np.random.Generator, seeds: int, partners: int, spread: tuple[float, float, float]
) -> np.ndarray:
    """Scores [S, P] about 0: an effect of the seed, one of the partner, and one of the pair."""
    seed, partner, pair = spread
    effects = seed * rng.normal(size=(seeds, 1)) + partner * rng.normal(size=partners)
    return effects + pair * rng.normal(size=(seeds, partners))


def stratified_counts(shape: tuple[int, int], resamples: int, seed: int) -> np.ndarray:
    """Counts [B, S * P] that resample the seeds of each partner apart: rliable's bootstrap."""
    seeds, partners = shape
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(seeds, np.full(seeds, 1.0 / seeds), size=(resamples, partners))
    return draws.transpose(0, 2, 1).reshape(resamples, seeds * partners)


def stratified(scores: np.ndarray, resamples: int, seed: int = 0) -> Estimate:
    """What `estimate` must not do for an ego that meets every partner."""
    counts = stratified_counts(scores.shape, resamples, seed)
    return bootstrap.replicate(scores.ravel(), counts, "seeds").estimate()


def coverage(
    figure: Callable[[np.random.Generator, int], Estimate], repetitions: int
) -> dict[str, float]:
    """Share of the IQM's and of the mean's intervals that hold the truth, 0."""
    rng = np.random.default_rng(1)
    figures = [figure(rng, seed) for seed in range(repetitions)]
    return {
        name: float(np.mean([holds(getattr(figure, name), 0.0) for figure in figures]))
        for name in ("iqm_ci", "mean_ci")
    }


def holds(interval: tuple[float, float] | None, truth: float) -> bool:
    return interval is not None and interval[0] <= truth <= interval[1]


def test_iqm_and_mean_have_own_intervals():
    scores = np.random.default_rng(0).exponential(size=(12, 20))
    figure = bootstrap.estimate(scores)
    assert figure.iqm == pytest.approx(scipy.stats.trim_mean(scores.ravel(), 0.25))
    assert figure.mean == pytest.approx(scores.mean())
    assert figure.iqm_ci is not None and figure.mean_ci is not None
    assert figure.iqm_ci[0] < figure.iqm < figure.iqm_ci[1] < figure.mean < figure.mean_ci[1]
    assert figure.n == 240


@pytest.mark.parametrize(
    ("shape", "common"), [((4, 6), False), ((4, 6, 5), True), ((4, 1, 5), False)]
)
def test_draws_equal_resampling_of_whole_axes(shape: tuple[int, ...], common: bool):
    """Seeds, partners and, if all meet the same, starts."""
    returns = np.random.default_rng(0).normal(size=shape)
    counts = bootstrap.crossed_counts(returns.shape, common, 50, seed=3)
    draws = bootstrap.replicate_crossed(returns, counts)
    assert (counts.starts is None) == (len(shape) == 2)
    for b in range(50):
        drawn = (counts.seeds, counts.partners, counts.starts)
        axes = [axis[b] for axis in drawn if axis is not None]
        resampled = returns[np.ix_(*(np.repeat(np.arange(len(axis)), axis) for axis in axes))]
        assert resampled.shape == returns.shape
        scores = resampled.reshape(*shape[:2], -1).mean(axis=2).ravel()
        assert draws.means[b] == pytest.approx(scores.mean())
        assert draws.iqms[b] == pytest.approx(scipy.stats.trim_mean(scores, 0.25))


def test_partners_bring_starts_of_their_own_along():
    returns = np.random.default_rng(0).normal(size=(4, 6, 5))
    assert bootstrap.estimate(returns) == bootstrap.estimate(returns.mean(axis=2))


def test_interval_depends_on_seed_not_chunks(monkeypatch: pytest.MonkeyPatch):
    scores = np.random.default_rng(0).normal(size=(5, 9))
    whole = bootstrap.estimate(scores, seed=4).iqm_ci
    # A chunk's size is set for memory, and results may not depend on it.
    monkeypatch.setattr(bootstrap, "_ENTRIES_AT_ONCE", 700)
    assert bootstrap.estimate(scores, seed=4).iqm_ci == pytest.approx(whole, rel=1e-12)
    assert bootstrap.estimate(scores, seed=5).iqm_ci != whole


@pytest.mark.parametrize(
    ("shape", "generalises_to"),
    [
        ((3, 4), "seeds and partners"),
        ((1, 4), "partners"),
        ((1, 4, 2), "partners"),
        ((3, 1), "seeds"),
        ((3, 1, 2), "seeds and starts"),
        ((1, 1, 2), "starts"),
        ((1, 1, 1), "nothing"),
        ((1, 1), "nothing"),
    ],
)
def test_every_figure_says_what_it_generalises_to(shape: tuple[int, ...], generalises_to: str):
    figure = bootstrap.estimate(np.random.default_rng(0).normal(size=shape))
    assert figure.generalises_to == generalises_to
    assert (figure.iqm_ci is None) == (figure.mean_ci is None) == (generalises_to == "nothing")


def test_single_seed_resamples_only_partners():
    scores = np.random.default_rng(0).normal(size=(1, 30))
    figure = bootstrap.estimate(scores, resamples=4000)
    plain = scipy.stats.bootstrap(
        scores, np.mean, method="percentile", n_resamples=4000, rng=np.random.default_rng(0)
    )
    assert figure.mean_ci == pytest.approx(tuple(plain.confidence_interval), abs=0.03)


def test_wrong_use_is_refused():
    with pytest.raises(ValueError, match=r"shape \(2, 3, 4, 5\).*partners\].*not seeds"):
        bootstrap.estimate(np.zeros((2, 3, 4, 5)))


def test_equal_resamples_subtract_to_paired_difference():
    rng = np.random.default_rng(0)
    scores = rng.normal(size=(10, 20))
    counts = bootstrap.crossed_counts(scores.shape, False, 500, seed=0)
    base, better = (bootstrap.replicate_crossed(x, counts) for x in (scores, scores + 1.0))
    figure = (better - base).estimate()
    assert figure.mean_ci == pytest.approx((1.0, 1.0))
    assert figure.mean == pytest.approx(1.0)


def test_band_contains_curve():
    values = np.random.default_rng(0).normal(size=(8, 30)) + np.linspace(0, 100, 30)
    band = bootstrap.curve_band(values)
    assert band is not None
    centre, low, high = band
    assert np.all((low <= centre) & (centre <= high))
    assert bootstrap.curve_band(values[:1]) is None
    scores, thresholds = values / 100, np.linspace(0, 1, 11)
    profile = bootstrap.profile_band(scores, thresholds)
    assert profile is not None
    share = (scores.ravel()[:, None] > thresholds).mean(axis=0)
    assert np.all((profile[0] <= share) & (share <= profile[1]))


@pytest.mark.slow_for("spread1", "spread2")
@pytest.mark.parametrize(
    ("seeds", "partners", "spread"),
    [(1, 64, (0.0, 1.0, 1.0)), (32, 32, (1.0, 1.0, 1.0)), (32, 32, (1.0, 0.3, 0.3))],
)
@pytest.mark.parametrize("repetitions", [300, pytest.param(2000, marks=pytest.mark.slow)])
def test_cluster_intervals_cover(
    seeds: int, partners: int, spread: tuple[float, float, float], repetitions: int
):
    def figure(rng: np.random.Generator, seed: int) -> Estimate:
        return bootstrap.estimate(crossed(rng, seeds, partners, spread), resamples=300, seed=seed)

    margin = 0.0 if repetitions == 2000 else 0.02  # 300 repetitions have a standard error of 1.3%
    for name, covered in coverage(figure, repetitions).items():
        assert 0.93 - margin <= covered <= 0.97 + margin, name


def with_starts(
    rng: np.random.Generator, shape: tuple[int, int, int], common: bool, start: float = 3.0
) -> np.ndarray:
    """Returns [S, P, K] about 0, whose starts matter more than seeds, partners and pairs.

    A single seed or partner has no effect: an interval that does not resample it is about it.
    """
    seeds, partners, episodes = shape
    starts = rng.normal(size=(1 if common else partners, episodes))
    noise = rng.normal(size=shape)
    spread = 0.3 * (seeds > 1), 0.3 * (partners > 1), 0.3 * (seeds * partners > 1)
    return crossed(rng, seeds, partners, spread)[:, :, None] + start * starts + noise


@pytest.mark.parametrize(
    ("shape", "common"),
    [((1, 64, 2), False), ((24, 32, 9), False), ((8, 32, 32), True), ((1, 1, 32), False)],
)
@pytest.mark.parametrize("repetitions", [300, 2000])
@pytest.mark.slow
def test_intervals_cover_the_luck_of_the_starts(
    shape: tuple[int, int, int], common: bool, repetitions: int
):
    def figure(rng: np.random.Generator, seed: int) -> Estimate:
        returns = with_starts(rng, shape, common)
        return bootstrap.estimate(returns, common_starts=common, resamples=300, seed=seed)

    margin = 0.01 if repetitions == 2000 else 0.03
    for name, covered in coverage(figure, repetitions).items():
        assert 0.92 - margin <= covered <= 0.98 + margin, name


def test_planted_defect_fixed_common_starts_are_caught():
    """Nine starts that all 32 partners share are nine draws, however many partners there are."""

    def wrong(rng: np.random.Generator, seed: int) -> Estimate:
        returns = with_starts(rng, (4, 32, 9), common=True)
        return bootstrap.estimate(returns.mean(axis=2), resamples=200, seed=seed)

    assert max(coverage(wrong, 200).values()) < 0.6


def test_few_seeds_are_covered_too_little_as_documented():
    def figure(rng: np.random.Generator, seed: int) -> Estimate:
        return bootstrap.estimate(crossed(rng, 3, 32, (1.0, 0.3, 0.3)), resamples=300, seed=seed)

    assert 0.65 <= coverage(figure, 300)["iqm_ci"] <= 0.85


def test_planted_defect_episodes_resampled_as_seeds_are_caught():
    """Eight episodes of each of 8 seeds taken for 64 seeds."""

    def wrong(rng: np.random.Generator, seed: int) -> Estimate:
        scores = crossed(rng, 8, 8, (1.0, 0.3, 0.3))
        episodes = scores[:, :, None] + 0.5 * rng.normal(size=(8, 8, 8))
        as_seeds = episodes.transpose(0, 2, 1).reshape(64, 8)
        return stratified(as_seeds, resamples=200, seed=seed)

    assert max(coverage(wrong, 200).values()) < 0.5


def test_planted_defect_stratified_seeds_are_caught():
    """A seed's effect is common to its whole row; resampling columns apart averages it away."""

    def wrong(rng: np.random.Generator, seed: int) -> Estimate:
        return stratified(crossed(rng, 16, 16, (1.0, 0.0, 1.0)), resamples=200, seed=seed)

    assert max(coverage(wrong, 200).values()) < 0.7
