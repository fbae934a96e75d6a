"""Readers find wishes that show, and nothing where none shows or labels are those of others."""

import numpy as np
import pytest

from assistax_envs.preferences import WORDS
from assistax_workshop.gates.persons.reader import (
    POOLED,
    Windows,
    moments,
    read_thirds,
    share_found,
)

PERSONS, STEPS = 240, 3 * POOLED


def _windows(rng: np.random.Generator, where: int | None) -> Windows:
    """Return windows of persons who show the first wish in a column, and never the second."""
    thirds = rng.integers(0, 3, (PERSONS, 2))
    obs = rng.normal(0.0, 0.3, (STEPS, PERSONS, 3 + len(WORDS)))
    if where is not None:
        obs[STEPS // 2 :, :, where] += thirds[:, 0] - 1.0
    return Windows(moments(obs.astype(np.float32)), thirds)


@pytest.mark.parametrize(
    ("where", "finding"), [(1, ("both", "body")), (-2, ("both", "words")), (None, ())]
)
def test_readers_find_what_they_see(where: int | None, finding: tuple[str, ...]) -> None:
    rng = np.random.default_rng(3)
    learn, test = (_windows(rng, where) for _ in range(2))
    found = read_thirds(learn, test, updates=120)
    shares = {seen: share_found(thirds[:, 0], test.thirds[:, 0]) for seen, thirds in found.items()}
    for seen, share in shares.items():
        assert share > 0.8 if seen in finding else share < 0.5, (seen, share)
    assert share_found(found["both"][:, 1], test.thirds[:, 1]) < 0.5


def test_who_always_says_the_same_finds_a_third() -> None:
    thirds = np.array([0] * 90 + [1] * 9 + [2])
    assert share_found(np.zeros(100, int), thirds) == pytest.approx(1 / 3)
    assert share_found(thirds, thirds) == 1.0


def test_moments_hold_means_changes_and_words() -> None:
    obs = np.zeros((2 * POOLED + 5, 1, 1 + len(WORDS)), np.float32)
    obs[: 2 * POOLED, 0, 0] = np.arange(2 * POOLED)
    obs[POOLED : 2 * POOLED, 0, -1] = 1.0
    found = moments(obs)
    assert found.shape == (1, 2, 2 + len(WORDS))
    np.testing.assert_allclose(found[0, :, 0], [(POOLED - 1) / 2, POOLED + (POOLED - 1) / 2])
    np.testing.assert_allclose(found[0, :, 1], [1.0 - 1.0 / POOLED, 1.0])
    np.testing.assert_allclose(found[0, :, -1], [0.0, 1.0])
