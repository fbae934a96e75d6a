"""A critic that sees what the robot does not: the world, the wishes, and who the partner is.

Pinto et al., 2018, "Asymmetric Actor Critic for Image-Based Robot Learning". The actor is PPO's.
"""

import dataclasses

import jax
import jax.numpy as jnp

from population.methods.hidden import WHO, standardised
from population.methods.method import Method
from population.networks.policy import Critic, CriticSpec
from population.networks.seat import Carry, Params

WIDTH = 16  # of what the critic learns about each partner


class Asymmetric(Method):
    """V(s, e) with the global observation s and e = E[partner] in R^16, learned with the critic.

    For partners with numbers x, such as persons, e = E x. `critic=local` leaves the world out,
    which is the method's ablation together with `method=""`.
    """

    sees = critic_sees = (WHO,)

    def critic(self, spec: CriticSpec) -> Critic:
        """Return the critic that reads observations [..., O + 1], the partner's place last."""
        if self.partners is None:
            raise ValueError("the critic of method 'asymmetric' learns about partners; give some")
        numbers = standardised(self.partners.numbers)
        places = len(self.partners) if self.partners.numbers is None else 0
        return _PartnerCritic(spec, jnp.asarray(numbers), places)


class _PartnerCritic(Critic):
    """Replaces the last number that it reads, a partner's place, by what it learns about it."""

    def __init__(self, spec: CriticSpec, numbers: jax.Array, places: int) -> None:
        super().__init__(_widened(spec))
        self._numbers, self._places = numbers, places

    def init(self, key: jax.Array) -> Params:
        own, table = jax.random.split(key)
        rows = self._places or self._numbers.shape[1]
        scale = 1.0 if self._places else rows**-0.5  # e then has entries of about 1
        return {**super().init(own), "partners": scale * jax.random.normal(table, (rows, WIDTH))}

    def inputs(self, params: Params, obs: jax.Array) -> jax.Array:
        who = obs[..., -1].astype(jnp.int32)
        table = params["partners"]
        learned = table[who] if self._places else self._numbers[who] @ table
        return jnp.concatenate([obs[..., :-1], learned], axis=-1)

    def step(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, jax.Array]:
        own = {name: value for name, value in params.items() if name != "partners"}
        return super().step(own, carry, self.inputs(params, obs), first)


def _widened(spec: CriticSpec) -> CriticSpec:
    return dataclasses.replace(spec, observation_size=spec.observation_size - 1 + WIDTH)
