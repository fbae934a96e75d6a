import jax.numpy as jnp
import numpy as np

from population.trainers import normaliser


def test_merged_batches_have_the_statistics_of_all():
    batches = [
        np.random.default_rng(seed).normal(3.0, 2.0 + seed, (50 + seed, 4, 3)) for seed in range(4)
    ]
    statistics = normaliser.empty(3)
    for batch in batches:
        statistics = normaliser.update(statistics, jnp.asarray(batch, jnp.float32))
    everything = np.concatenate([batch.reshape(-1, 3) for batch in batches])
    np.testing.assert_allclose(statistics.mean, everything.mean(0), rtol=1e-4)
    np.testing.assert_allclose(statistics.variance, everything.var(0), rtol=1e-4)
    np.testing.assert_allclose(
        normaliser.to_params(statistics)["std"], everything.std(0), rtol=1e-4
    )


def test_constant_feature_stays_finite():
    statistics = normaliser.update(normaliser.empty(1), jnp.ones((10, 1)))
    assert normaliser.to_params(statistics)["std"][0] >= 1e-3
