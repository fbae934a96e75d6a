"""Rewards of scratch against Table 5."""

import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs.tasks.scratch.task import BEST_FORCE, BEST_SPEED, scratch_terms


def test_perfect_episode_earns_the_paper_bound() -> None:
    terms = scratch_terms(jnp.zeros(1), jnp.full(1, BEST_SPEED), jnp.full(1, BEST_FORCE))
    assert round(1000 * sum(float(term[0]) for term in terms.values())) == 1135


def test_no_step_earns_more_than_the_bound() -> None:
    distance, speed, force = (
        axis.ravel()
        for axis in jnp.meshgrid(*(jnp.linspace(0.0, top, 40) for top in (0.3, 1.0, 30.0)))
    )
    terms = scratch_terms(distance, speed, force)
    assert float((terms["reach_target"] + terms["scratch"]).max()) <= 1.0 + np.exp(-2.0) + 1e-6


@pytest.mark.parametrize(
    ("distance", "speed", "force", "paid"),
    [(0.099, 0.1, 3.0, np.exp(-2.0)), (0.101, 0.1, 3.0, 0.0), (0.05, 0.0, 3.0, 0.0), (0.05, 0.1,
    0.0, 0.0),
     (0.05, 0.2, 3.0, 2 * np.exp(-3.0)), (0.05, 0.1, 6.0, 2 * np.exp(-3.0))],
)  # fmt: skip
def test_scratching_pays_near_the_target_alone(
    distance: float, speed: float, force: float, paid: float
) -> None:
    terms = scratch_terms(jnp.array([distance]), jnp.array([speed]), jnp.array([force]))
    assert float(terms["scratch"][0]) == pytest.approx(paid, rel=1e-5)
    assert float(terms["reach_target"][0]) == pytest.approx(np.exp(-(distance**2) / 0.1), rel=1e-5)
