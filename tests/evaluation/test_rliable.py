"""Cross-check with rliable (Agarwal et al., arXiv 2108.13264) if it is installed.

`pip install rliable 'pandas<3'`.
"""

import inspect
from typing import Any

import numpy as np
import pytest

from assistax_base import statistics
from tests.evaluation.test_bootstrap import stratified
from tools.release_page.paper.measures import probability_of_improvement

metrics = pytest.importorskip(
    "rliable.metrics", reason="an optional cross-check: pip install rliable"
)
library = pytest.importorskip(
    "rliable.library", reason="an optional cross-check: pip install rliable"
)
SCORES = np.random.default_rng(0).normal(0.5, 0.2, (10, 16))  # [seeds, partners]


def test_aggregates_are_those_of_rliable():
    assert statistics.iqm(SCORES) == pytest.approx(metrics.aggregate_iqm(SCORES))
    assert statistics.mean(SCORES) == pytest.approx(metrics.aggregate_mean(SCORES))
    other = SCORES + 0.05
    expected = metrics.probability_of_improvement(SCORES, other)
    assert probability_of_improvement(SCORES, other) == pytest.approx(expected, abs=1e-6)


@pytest.fixture
def arch_of_any_release(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let rliable, written for arch 5, run on later ones, which call `random_state` `seed`."""
    base = pytest.importorskip("arch.bootstrap.base").IIDBootstrap
    original = base.__init__
    if "random_state" in inspect.signature(original).parameters:
        return

    def renamed(self: Any, *args: Any, random_state: Any = None, **options: Any) -> None:
        original(self, *args, seed=random_state, **options)
        self.random_state = self.generator

    monkeypatch.setattr(base, "__init__", renamed)


@pytest.mark.filterwarnings(
    "ignore:random_state is deprecated:FutureWarning"
)  # rliable's own call of arch
@pytest.mark.usefixtures("arch_of_any_release")
def test_stratified_intervals_agree_within_monte_carlo_error():
    ours = stratified(SCORES, resamples=5000)
    np.random.seed(0)  # rliable draws from the global state
    _, theirs = library.get_interval_estimates(
        {"method": SCORES},
        lambda scores: np.array([metrics.aggregate_iqm(scores)]),
        reps=5000,
        random_state=np.random.RandomState(0),
    )
    assert ours.iqm_ci is not None
    width = ours.iqm_ci[1] - ours.iqm_ci[0]
    np.testing.assert_allclose(ours.iqm_ci, theirs["method"][:, 0], atol=0.06 * width)
