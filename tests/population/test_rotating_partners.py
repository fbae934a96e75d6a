"""Partners who change seats: everybody plays equally often, each as itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import DISABILITY_SETTINGS
from population.networks.policy import Policy
from population.partners.rotating import RotatingPartners
from tests.population.test_frozen_partners import PLAIN, SQUASHED, population

SETTINGS = {"a": "d1", "b": "d3", "c": "d9"}


def episodes(rotating: RotatingPartners, n: int, count: int) -> list:
    """Return who sits there, and their bodies, in some episodes one after the other."""
    seen, before = [], None
    for key in jax.random.split(jax.random.key(3), count):
        before, humans = rotating.begin(rotating.params, key, before, n)
        seen.append((before, humans))
    return seen


@pytest.mark.parametrize("n", [1, 2, 3, 6, 7])
def test_every_simulation_meets_the_next_partner_each_episode(n: int) -> None:
    rotating = RotatingPartners(population())
    met = np.array([rotating.names(seated, n) for seated, _ in episodes(rotating, n, 6)])
    for row in met.T:  # three partners: all of them in three episodes, and again in the same order
        assert set(row[:3]) == {"a", "b", "c"}
        assert row[:3].tolist() == row[3:].tolist()


@pytest.mark.parametrize("n", [2, 7])
def test_whoever_sits_there_acts_with_its_own_body(n: int) -> None:
    """The oracle asks each partner simulation by simulation."""
    rotating = RotatingPartners(population())
    obs = jax.random.normal(jax.random.key(1), (n, 3))
    [plain, squashed] = rotating.frozen.stacks
    rows = {name: (PLAIN, plain.row(i)) for i, name in enumerate(plain.ids)}
    rows |= {name: (SQUASHED, squashed.row(i)) for i, name in enumerate(squashed.ids)}
    for seated, humans in episodes(rotating, n, 3):
        names = rotating.names(seated, n)
        _, actions = rotating.act(rotating.params, seated, obs, jnp.zeros(n, bool))
        for index, name in enumerate(names):
            spec, params = rows[name]
            policy = Policy(spec)
            carry = policy.initial_carry((1,))
            _, expected = policy.act(params, carry, obs[index : index + 1], jnp.zeros(1, bool))
            np.testing.assert_allclose(actions[index], expected[0], atol=1e-5)
            body = DISABILITY_SETTINGS[SETTINGS[name]]
            np.testing.assert_allclose(humans.strength[index], body.strength)
            np.testing.assert_allclose(humans.elbow_range[index], body.elbow_range)
            assert humans.preference_code[index] == 0


def test_preferences_are_drawn_among_those_allowed() -> None:
    rotating = RotatingPartners(population(), ("p2", "p7"))
    drawn = [np.asarray(humans.preference_code) for _, humans in episodes(rotating, 40, 2)]
    assert set(np.concatenate(drawn).tolist()) == {2, 7}
    assert not np.array_equal(*drawn)
