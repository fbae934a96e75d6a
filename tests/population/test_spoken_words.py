"""Words of persons reach the robots that learn with them, from every kind of partner."""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs.persons import PersonPlayer, persons
from assistax_envs.persons.rows import marked
from assistax_envs.preferences import WORDS, code
from population.config import MIXED, Member, TrainConfig
from population.hyperparameters import PPOConfig
from population.networks.stack import PolicyStack
from population.partners.drawn_persons import DrawnPersons, IdlePersons
from population.partners.frozen import FrozenPartners
from population.play.seats import said
from population.runs.train import initial_state, make_trainer
from tests.population.test_frozen_partners import PLAIN, stack

TASK = "gentle_scratch"
ROWS = persons(TASK)[:8]


class Saying:
    """Player of the human's seat that says a word: so many codes more in each step."""

    controller = PersonPlayer(TASK).controller

    def __init__(self, word: int) -> None:
        self._word = word

    def initial_carry(self, batch_shape: tuple[int, ...]) -> Any:
        return jnp.zeros(batch_shape, jnp.int32)

    def act(self, params: Any, carry: Any, obs: jax.Array, first: jax.Array) -> Any:
        del params, first
        return carry + self._word, jnp.zeros((*obs.shape[:-1], 3))

    def word(self, carry: Any) -> jax.Array:
        return jnp.asarray(carry, jnp.int32)


@dataclasses.dataclass(frozen=True)
class Speakers:
    """Spec of partners that say one word more in each step."""

    role: ClassVar = "human"
    observation_size: ClassVar = 3
    action_size: ClassVar = 2

    def player(self) -> Any:
        return Mute(1)


class Mute(Saying):
    """A `Saying` of two torques."""

    def act(self, params: Any, carry: Any, obs: jax.Array, first: jax.Array) -> Any:
        carry, action = super().act(params, carry, obs, first)
        return carry + params["more"], action[..., :2]


def heard_in_training(partners: DrawnPersons) -> np.ndarray:
    """Return what robots that learn hear [N, 8] after four steps."""
    env = assistax_envs.make(TASK, "native")
    config = PPOConfig(num_envs=4, rollout_steps=4, minibatches=1, hidden=(8, 8))
    run = TrainConfig(TASK, "ppo", (Member(0, MIXED),), 1, config, partners=partners.ids)
    trainer = make_trainer(run, env, partners)
    state = initial_state(run, trainer)
    state, _ = jax.jit(trainer.update)(state, trainer.hyper(run.members), partners.params)
    return np.asarray(state.simulations.env.obs["robot"])[:, -len(WORDS) :]


@pytest.mark.slow
@pytest.mark.parametrize("idle", [False, True], ids=["persons", "idle"])
def test_learning_robot_hears_its_persons(idle: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """All persons say "stop" in every step; idle ones have the same player, and say nothing."""
    player = PersonPlayer(TASK)
    monkeypatch.setattr(
        player, "word", lambda carry: jnp.full(carry.age.shape, code("stop"), jnp.int32)
    )
    made = IdlePersons if idle else DrawnPersons
    heard = heard_in_training(made(player, jnp.asarray(marked(ROWS)), "eight"))
    expected = np.zeros(len(WORDS))
    expected[WORDS.index("stop")] = not idle
    np.testing.assert_array_equal(heard, np.tile(expected, (4, 1)))


def test_frozen_partners_speak_in_their_own_simulations() -> None:
    """Simulations are [member, partner, simulation]; networks among the partners are mute."""
    more = {"more": np.array([10, 20], np.int32)}
    speaking = PolicyStack(Speakers(), ("x", "y"), more)
    bodies = dict.fromkeys(("a", "b", "x", "y"), assistax_envs.DISABILITY_SETTINGS["d1"])
    both = FrozenPartners([stack(PLAIN, ("a", "b")), speaking], bodies)
    obs, members = jnp.zeros((2 * 4 * 3, 3)), 2
    carry = both.initial_carry(len(obs))
    carry, _ = both.act(both.params, carry, obs, jnp.zeros(len(obs), bool), members)
    words = both.words(carry, members)
    assert words is not None and words.dtype == jnp.int32
    assert words.reshape(2, 4, 3).tolist() == [[[0] * 3, [0] * 3, [11] * 3, [21] * 3]] * 2
    mute = FrozenPartners([stack(PLAIN, ("a", "b"))], bodies)
    assert mute.words(mute.initial_carry(8), members) is None


def test_networks_in_the_seat_say_nothing() -> None:
    policies = [stack(PLAIN, ("a", "b")), PolicyStack(Speakers(), ("x",), {"more": np.array([7])})]
    players = [group.spec.player() for group in policies]
    params = [group.params for group in policies]
    carries = [(), jnp.full((1, 4), 7)]
    words = said(players, params, carries, 4)
    assert words is not None and words.tolist() == [[0] * 4, [0] * 4, [7] * 4]
    assert said(players[:1], params[:1], carries[:1], 4) is None
