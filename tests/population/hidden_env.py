"""Probe environments for methods: a partner has a bit that pays, or one that only adds noise."""

import dataclasses

import jax
import jax.numpy as jnp

from assistax_envs import DISABILITY_SETTINGS
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack
from population.partners.frozen import FrozenPartners
from tests.population.toy_env import ToyEnv, ToyState

LENGTH, OWN = 12, 0.02
PARTNERS = ("a", "b", "c", "d")
SETTINGS = dict(zip(PARTNERS, ("d1", "d3", "d7", "d9"), strict=True))


class HiddenBit(ToyEnv):
    """The human always sees its bit and acts on it; the robot sees it in the second step alone.

    In the steps after, a feed-forward robot earns 0 on average, and one with a memory 1 a step.
    """

    sight = 1  # the step in which the robot sees it

    def __init__(self) -> None:
        super().__init__(read, episode_length=LENGTH, memory=True)

    def _observe(self, cue, keys, step, shown):
        obs = super()._observe(cue, keys, step, shown=True)
        glimpse = cue["human"] * (step == self.sight)
        return {**obs, "robot": obs["robot"].at[:, 0].set(glimpse)}

    @staticmethod
    def joint_positions(state):
        """Each human turns its joint towards its bit: what it does next is known from the bit."""
        turn = 0.01 * state.cue["human"] * state.step
        return {"robot": jnp.zeros((len(turn), 1)), "human": turn[:, None]}


class Settings(HiddenBit):
    """The human's bit is that of its body: the weaker half of all settings acts on -1."""

    def _blank(self, keys, params):
        state = super()._blank(keys, params)
        if params is None:
            return state
        bit = jnp.where(params.strength > 0.6, 1.0, -1.0)
        cue = {**state.cue, "human": bit}
        obs = self._observe(cue, keys, state.step, shown=True)
        return dataclasses.replace(state, cue=cue, obs=obs)


class LateSight(Settings):
    """The robot sees the bit in the last step: it is of use in the next episode alone."""

    sight = LENGTH - 1


def read(state: ToyState, action: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Reward 1 a step for half of the human's bit, 0 for nothing, -3 for its opposite."""
    error = jnp.square(action["robot"] - 0.5 * state.cue["human"])
    return {"read": 1.0 - 4.0 * error}


def noisy(state: ToyState, action: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Reward at most OWN for the robot's own cue, beside what partners bring, whatever it does."""
    own = OWN * (1.0 - 4.0 * jnp.square(action["robot"] - 0.5 * state.cue["robot"]))
    params = state.params
    brought = jnp.zeros_like(own) if params is None else 4.0 * (params.strength - 0.6)
    return {"own": own, "brought": brought}


def partners() -> FrozenPartners:
    """Four humans who act on the first number that they see."""
    spec = PolicySpec("human", 3, 2, hidden=(4,), normalise=False)
    tree = Policy(spec).init(jax.random.key(0))
    tree = jax.tree.map(jnp.zeros_like, tree)
    tree["Dense_0"]["kernel"] = tree["Dense_0"]["kernel"].at[0, 0].set(2.0)
    tree["Dense_1"]["kernel"] = tree["Dense_1"]["kernel"].at[0].set(0.8)
    stacked = jax.tree.map(lambda leaf: jnp.stack([leaf] * len(PARTNERS)), tree)
    settings = {name: DISABILITY_SETTINGS[setting] for name, setting in SETTINGS.items()}
    return FrozenPartners([PolicyStack(spec, PARTNERS, stacked)], settings)
