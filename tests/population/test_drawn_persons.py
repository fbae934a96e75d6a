"""Robots that meet a new person each episode: whom they meet, and that a run can go on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs.persons import PersonPlayer, numbers, person_params, persons
from assistax_envs.persons.rows import FAMILIES, INNER, WIDTH, marked
from assistax_envs.persons.senses import SEAT_SIZES
from population.config import MIXED, Member, TrainConfig
from population.environment import ToldNumbers
from population.hyperparameters import PPOConfig
from population.partners.drawn_persons import DrawnPersons, IdlePersons, OnePersonEach
from population.runs.train import initial_state, make_trainer

TASK = "gentle_scratch"
TRAINING = numbers("training")
ROWS = persons(TASK)[TRAINING[TRAINING < INNER]]


@pytest.fixture(scope="module")
def partners() -> DrawnPersons:
    return DrawnPersons(PersonPlayer(TASK), jnp.asarray(marked(ROWS)), "everybody")


def test_episode_has_drawn_persons_body_and_wishes(partners: DrawnPersons) -> None:
    keys = jax.random.split(jax.random.key(3), 40)
    humans = partners.renewed(partners.humans(40), keys)
    met = np.asarray(humans.person)
    assert len(set(met.tolist())) > 35  # of 7200
    expected = person_params(TASK, ROWS[met])
    for name in ("elbow_range", "preference"):
        pair = (jax.tree.leaves(getattr(params, name)) for params in (humans, expected))
        assert all(map(np.array_equal, *pair))
    again = partners.renewed(humans, keys[:7])
    np.testing.assert_array_equal(again.person, met[:7])


def test_who_is_there_is_who_acts(partners: DrawnPersons) -> None:
    humans = partners.renewed(partners.humans(32), jax.random.split(jax.random.key(4), 32))
    obs = 0.3 * jax.random.normal(jax.random.key(5), (32, SEAT_SIZES[TASK][0]))
    first, carry = jnp.ones(32, bool), partners.initial_carry(32)
    act = jax.jit(partners.act, static_argnums=4)
    _, actions = act(partners.params, carry, obs, first, 2, humans)

    def one_by_row(table: jax.Array, who: jax.Array) -> jax.Array:
        # Rows are looked up inside: another program may round the last bit otherwise.
        return partners.player.act({"row": table[who]}, carry, obs, first)[1]

    expected = jax.jit(one_by_row)(jnp.asarray(marked(ROWS)), humans.person)
    np.testing.assert_allclose(actions, expected, rtol=0.0, atol=1e-7)
    others = dataclasses.replace(humans, person=humans.person[::-1])
    _, changed = act(partners.params, carry, obs, first, 2, others)
    assert not np.array_equal(actions, changed)


def test_persons_act_as_their_family_does() -> None:
    """A person acts the same whatever the families of the others are, and families differ."""
    places = np.arange(len(FAMILIES)).repeat(2)
    rows = np.tile(ROWS[:2], (len(FAMILIES), 1))
    mixed = DrawnPersons(PersonPlayer(TASK), jnp.asarray(marked(rows, places)), "mixed")
    np.testing.assert_array_equal(mixed.numbers, rows)
    humans = mixed.humans(len(rows))
    humans = dataclasses.replace(humans, person=jnp.arange(len(rows)))
    drawn = jax.random.normal(jax.random.key(5), (30, 2, SEAT_SIZES[TASK][0]))
    act = jax.jit(mixed.act, static_argnums=4)

    def play(table: np.ndarray) -> np.ndarray:
        """Return the actions [T, 6, 3] of persons that observe the same, two by two."""
        carry, actions = mixed.initial_carry(len(rows)), []
        for step, seen in enumerate(0.3 * drawn):
            obs, first = jnp.tile(seen, (len(FAMILIES), 1)), jnp.full(len(rows), step == 0)
            carry, action = act(jnp.asarray(table), carry, obs, first, 1, humans)
            actions.append(action)
        return np.array(actions)

    together = play(marked(rows, places))
    for family in range(len(FAMILIES)):
        own = places == family
        np.testing.assert_array_equal(together[:, own], play(marked(rows, family))[:, own])
        np.testing.assert_array_equal((together[:, own] != together[:, :2]).any(), family > 0)


@pytest.mark.slow
def test_told_robot_observes_its_persons_numbers(partners: DrawnPersons) -> None:
    env = assistax_envs.make(TASK, "native", told=("human", "robot"))
    telling = ToldNumbers(env, partners.numbers)
    keys = jax.random.split(jax.random.key(6), 3)
    humans = partners.renewed(partners.humans(3), keys)
    state = jax.jit(telling.reset)(keys, humans)
    own = env.observation_size["robot"]
    assert telling.observation_size["robot"] == own + WIDTH == state.obs["robot"].shape[1]
    np.testing.assert_array_equal(state.obs["robot"][:, own:], ROWS[np.asarray(humans.person)])
    action = {role: jnp.zeros((3, size)) for role, size in env.action_size.items()}
    after = jax.jit(telling.step)(state, action)
    plain = jax.jit(env.step)(jax.jit(env.reset)(keys, humans), action)
    np.testing.assert_array_equal(after.obs["robot"][:, own:], state.obs["robot"][:, own:])
    np.testing.assert_array_equal(after.obs["robot"][:, :own], plain.obs["robot"])
    with pytest.raises(ValueError, match="only persons have any"):
        ToldNumbers(env, None)


def test_what_does_not_fit_is_refused(partners: DrawnPersons) -> None:
    with pytest.raises(ValueError, match="have their own preferences; leave preferences out"):
        partners.humans(4, ("p1",))
    env = assistax_envs.make("gentle_bath", "native")
    with pytest.raises(ValueError, match="persons of gentle_scratch cannot sit in gentle_bath"):
        partners.check(env, 4)


@pytest.mark.slow
@pytest.mark.parametrize("torso", ["mlp", "gru"])
def test_person_changes_at_episode_end_and_survives_resume(
    partners: DrawnPersons, torso: str, monkeypatch
) -> None:
    env = assistax_envs.make(TASK, "native")
    monkeypatch.setattr(env, "episode_length", 6)
    config = PPOConfig(num_envs=4, rollout_steps=4, minibatches=1, hidden=(8, 8), torso=torso)
    run = TrainConfig(TASK, "ppo", (Member(0, MIXED),), 1, config, partners=partners.ids)
    trainer = make_trainer(run, env, partners)
    update = jax.jit(trainer.update)
    hyper = trainer.hyper(run.members)
    state, met, steps = initial_state(run, trainer), [], []
    states = [state]
    for _ in range(4):
        met.append(np.asarray(state.simulations.env.params.person))
        steps.append(np.asarray(state.simulations.env.step))
        state, _ = update(state, hyper, partners.params)
        states.append(state)
    assert len(set(np.concatenate(met).tolist())) > 6
    for before, after, old, new in zip(met, met[1:], steps, steps[1:], strict=False):
        ended = new < old + config.rollout_steps
        np.testing.assert_array_equal(before != after, ended)
    again = states[2]
    for _ in range(2):
        again, _ = update(again, hyper, partners.params)
    for here, there in zip(jax.tree.leaves(again), jax.tree.leaves(states[4]), strict=True):
        if not jnp.issubdtype(here.dtype, jax.dtypes.prng_key):
            np.testing.assert_array_equal(here, there)


def test_idle_persons_have_a_body_and_do_nothing() -> None:
    idle = IdlePersons(PersonPlayer(TASK), jnp.asarray(marked(ROWS)), "everybody")
    humans = idle.renewed(idle.humans(8), jax.random.split(jax.random.key(6), 8))
    assert len(set(np.asarray(humans.elbow_range).tolist())) > 1
    obs = jax.random.normal(jax.random.key(7), (8, SEAT_SIZES[TASK][0]))
    _, action = idle.act(idle.params, idle.initial_carry(8), obs, jnp.ones(8, bool), 1, humans)
    np.testing.assert_array_equal(action, np.zeros((8, 3)))


@pytest.mark.slow
def test_each_member_keeps_its_own_person() -> None:
    rows = ROWS[[5, 40, 7]]
    partners = OnePersonEach(PersonPlayer(TASK), jnp.asarray(marked(rows)), "three")
    config = PPOConfig(num_envs=4, rollout_steps=8, minibatches=2)
    members = tuple(Member(seed, MIXED) for seed in (1, 2, 3))
    run = TrainConfig(TASK, "ippo", members, 64, config, partners=partners.ids)
    trainer = make_trainer(run, assistax_envs.make(TASK, "fused"), partners)
    state = initial_state(run, trainer)
    humans = state.simulations.env.params
    np.testing.assert_array_equal(humans.person, np.repeat([0, 1, 2], 4))
    force = person_params(TASK, rows).preference.force
    np.testing.assert_array_equal(humans.preference.force, np.repeat(force, 4))
    keys = jax.random.split(jax.random.key(8), 12)
    np.testing.assert_array_equal(partners.renewed(humans, keys).person, humans.person)
    with pytest.raises(ValueError, match="member 3 has no person; there are 3 of them"):
        partners.humans(4, member=3)
