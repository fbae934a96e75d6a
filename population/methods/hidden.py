"""Facts hidden from robots, as observations that training may use."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.preferences import middles
from population.environment import Environment, EnvState, ShowingMore
from population.networks.policy import normalise
from population.networks.seat import Params
from population.networks.spec import ROLES

if TYPE_CHECKING:
    from population.partners.frozen import FrozenPartners

WHO, HIDDEN = "partner", "hidden"  # names of these observations
_SETTING = ("strength", "elbow_range", "tremor")


class WithHidden(ShowingMore):
    """An environment that also shows the partner's place and its hidden facts.

    "partner" [N, 1] is its place among the partners. "hidden" [N, W] is its preference, its
    body's setting and, of persons, their 30 numbers, standardised.

    Args:
        env: The environment.
        partners: Who sits in the other seat.
        num_envs: Simulations of a member.
    """

    def __init__(self, env: Environment, partners: "FrozenPartners", num_envs: int) -> None:
        super().__init__(env)
        self._partners, self._num_envs = partners, num_envs
        self._middles = np.array([middles(env.task)], np.float32)
        self._preferences = self._middles.shape[1]
        self._numbers = standardised(partners.numbers)
        width = self._preferences + len(_SETTING) + self._numbers.shape[1]
        self.observation_size |= {WHO: 1, HIDDEN: width}

    def _shown(self, state: EnvState) -> EnvState:
        who = self._partners.who(state.params, self._num_envs)
        parts = []
        if self._preferences:
            parts.append(jnp.log(state.measures.liked / jnp.asarray(self._middles)))
        parts += [getattr(state.params, name)[:, None] for name in _SETTING]
        if self._numbers.size:
            parts.append(jnp.asarray(self._numbers)[who])
        shown = {WHO: who[:, None].astype(jnp.float32), HIDDEN: jnp.concatenate(parts, axis=-1)}
        return dataclasses.replace(state, obs={**state.obs, **shown})


def beside(
    names: Sequence[str], obs: Mapping[str, jax.Array], normalisers: Mapping[str, Params]
) -> dict[str, jax.Array]:
    """Return observations by names; those of roles and of the world normalised."""
    usual = normalisers.keys() & {*ROLES, "global"}
    return {
        name: normalise(normalisers[name], obs[name]) if name in usual else obs[name]
        for name in names
    }


def standardised(numbers: np.ndarray | None) -> np.ndarray:
    """Return partners' numbers [P, W], each with mean 0 and deviation 1 over them.

    Of partners without numbers it is [0, 0].
    """
    if numbers is None:
        return np.zeros((0, 0), np.float32)
    spread = np.maximum(numbers.std(axis=0, dtype=np.float64), 1e-6)
    return ((numbers - numbers.mean(axis=0, dtype=np.float64)) / spread).astype(np.float32)
