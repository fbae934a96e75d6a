"""Persons and networks in one training: each acts in its half, and brings its own wishes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs.persons import PersonPlayer, person_params, persons
from assistax_envs.persons.rows import WIDTH, marked
from assistax_envs.persons.senses import SEAT_SIZES
from assistax_envs.preferences import PREFERENCES
from population.config import MIXED, Member, TrainConfig
from population.hyperparameters import robot_preset
from population.methods.hidden import standardised
from population.networks.spec import PolicySpec
from population.partners.drawn_persons import DrawnPersons
from population.partners.frozen import FrozenPartners
from population.partners.mixed import MixedPartners
from population.runs.train import initial_state, make_trainer
from tests.population.test_frozen_partners import frozen, stack

TASK = "gentle_scratch"
ROWS = persons(TASK)[:50]
OBS, ACTIONS = SEAT_SIZES[TASK]
SPEC = PolicySpec("human", OBS, ACTIONS, hidden=(8,))
MEMBERS, ENVS = 2, 8  # two networks: two simulations each, and four of persons


@pytest.fixture(scope="module")
def drawn() -> DrawnPersons:
    return DrawnPersons(PersonPlayer(TASK), jnp.asarray(marked(ROWS)), "everybody")


@pytest.fixture(scope="module")
def teams() -> FrozenPartners:
    return frozen([stack(SPEC, ("a", "b"))], {"a": "d1", "b": "d9"})


@pytest.fixture(scope="module")
def both(drawn: DrawnPersons, teams: FrozenPartners) -> MixedPartners:
    return MixedPartners(drawn, teams)


def of_members(leaf: jax.Array) -> np.ndarray:
    """Return an array [M, half, N / 2, ...] of leaves [M x N, ...]."""
    return np.asarray(leaf).reshape(MEMBERS, 2, ENVS // 2, *leaf.shape[1:])


def test_persons_change_and_networks_stay_with_a_drawn_wish(both: MixedPartners) -> None:
    start = [both.humans(ENVS) for _ in range(MEMBERS)]
    humans = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *start)
    met, wishes = [], []
    for key in jax.random.split(jax.random.key(0), 30):
        humans = both.renewed(humans, jax.random.split(key, MEMBERS * ENVS))
        met.append(of_members(both.who(humans, ENVS)))
        assert humans.preference is not None
        wishes.append(of_members(humans.preference.force))
    who = np.stack(met)
    assert len(set(who[:, :, 0].ravel().tolist())) > 40 and who[:, :, 0].max() < len(ROWS)
    np.testing.assert_array_equal(who[:, :, 1], np.broadcast_to([50, 50, 51, 51], (30, 2, 4)))
    expected = person_params(TASK, ROWS[who[:, :, 0].ravel()]).preference
    np.testing.assert_array_equal(np.stack(wishes)[:, :, 0].ravel(), expected.force)
    liked = {np.float32(one.force) for one in PREFERENCES.values()}
    assert {*np.stack(wishes)[:, :, 1].ravel()} == liked
    bodies = of_members(humans.strength)[:, 1]
    d1, d9 = (assistax_envs.DISABILITY_SETTINGS[name].strength for name in ("d1", "d9"))
    np.testing.assert_allclose(bodies, np.broadcast_to([d1, d1, d9, d9], (2, 4)), rtol=1e-6)


def test_each_kind_acts_as_without_the_other(
    both: MixedPartners, drawn: DrawnPersons, teams: FrozenPartners
) -> None:
    count = MEMBERS * ENVS
    start = [both.humans(ENVS) for _ in range(MEMBERS)]
    humans = both.renewed(
        jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *start),
        jax.random.split(jax.random.key(4), count),
    )
    obs = 0.3 * jax.random.normal(jax.random.key(5), (count, OBS))
    first = jnp.ones(count, bool)
    _, action = both.act(both.params, both.initial_carry(count), obs, first, MEMBERS, humans)

    def half(place: int) -> tuple:
        parts = (obs, first, humans)
        return jax.tree.map(lambda leaf: jnp.concatenate([*of_members(leaf)[:, place]]), parts)

    for place, kind in enumerate((drawn, teams)):
        seen, begins, who = half(place)
        carry = kind.initial_carry(count // 2)
        _, alone = kind.act(kind.params, carry, seen, begins, MEMBERS, who)
        mine = of_members(action)[:, place].reshape(alone.shape)
        np.testing.assert_allclose(mine, alone, rtol=0.0, atol=1e-6)


def test_numbers_tell_networks_apart(both: MixedPartners) -> None:
    numbers = standardised(both.numbers)
    assert numbers.shape == (52, WIDTH + 2)
    np.testing.assert_allclose(numbers[50:, :WIDTH], 0.0, atol=1e-4)
    assert (numbers[50, WIDTH:] > 0).tolist() == [True, False]
    assert np.unique(numbers, axis=0).shape[0] == 52


@pytest.mark.parametrize("envs", [6, 10])
def test_shares_are_equal(both: MixedPartners, envs: int) -> None:
    with pytest.raises(ValueError, match="2 networks in half of the simulations; choose a multipl"):
        both.check(assistax_envs.make(TASK, "native"), envs)


def test_members_lie_along_their_own_axes(both: MixedPartners) -> None:
    minds, carries = both.member_axes(both.initial_carry(16))
    assert {*jax.tree.leaves(minds)} == {0} and {*jax.tree.leaves(carries)} <= {1}


@pytest.mark.slow
def test_a_robot_learns_with_both(both: MixedPartners) -> None:
    changes = {"num_envs": ENVS, "rollout_steps": 4, "minibatches": 1, "hidden": (8,)}
    changes["liking_width"] = 0.7  # which the training narrows
    config = robot_preset("asymmetric_gru", **changes)
    members = tuple(Member(seed, MIXED) for seed in range(MEMBERS))
    run = TrainConfig(TASK, "asymmetric_gru", members, 1, config, partners=both.ids)
    env = assistax_envs.make(TASK, "native")
    trainer = make_trainer(run, env, both)
    state = initial_state(run, trainer)
    update = jax.jit(trainer.update)
    after, _ = update(state, trainer.hyper(members), both.params)
    after, _ = update(after, trainer.hyper(members), both.params)
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(after.members))
    moved = jax.tree.map(lambda a, b: bool(jnp.any(a != b)), state.members, after.members)
    assert any(jax.tree.leaves(moved))
