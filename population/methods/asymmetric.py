"""A critic that sees hidden facts: the world, the preference and the partner's identity.

Pinto et al., 2018, "Asymmetric Actor Critic for Image-Based Robot Learning". The actor is PPO's.
"""

import dataclasses

import jax
import jax.numpy as jnp

from population.methods.hidden import WHO, standardised
from population.methods.method import Method
from population.networks.policy import Critic, CriticSpec
from population.networks.seat import Carry, Params

WIDTH = 16  # of the critic's embedding of each partner


class Asymmetric(Method):
    """V(s, e) with the global observation s and e = E[partner] in R^16, learned with the critic.

    For partners with numbers x, such as persons, e = E x. `critic=local` leaves the world out,
    which is the method's ablation together with `method=""`.
    """

    sees = critic_sees = (WHO,)

    def critic(self, spec: CriticSpec) -> Critic:
        """Return the critic of observations [..., O + 1] that end in the partner's index."""
        if self.partners is None:
            raise ValueError("method 'asymmetric' trains a critic of partners; give partners")
        numbers = standardised(self.partners.numbers)
        places = len(self.partners) if self.partners.numbers is None else 0
        return _PartnerCritic(spec, jnp.asarray(numbers), places)


class _PartnerCritic(Critic):
    """Critic that replaces its last input, a partner's index, by that partner's embedding."""

    def __init__(self, spec: CriticSpec, numbers: jax.Array, places: int) -> None:
        super().__init__(_widened(spec))
        self._numbers, self._places = numbers, places

    def init(self, key: jax.Array) -> Params:
        network_key, table_key = jax.random.split(key)
        rows = self._places or self._numbers.shape[1]
        scale = 1.0 if self._places else rows**-0.5  # e then has entries of about 1
        return {
            **super().init(network_key),
            "partners": scale * jax.random.normal(table_key, (rows, WIDTH)),
        }

    def inputs(self, params: Params, obs: jax.Array) -> jax.Array:
        partner = obs[..., -1].astype(jnp.int32)
        table = params["partners"]
        embedding = table[partner] if self._places else self._numbers[partner] @ table
        return jnp.concatenate([obs[..., :-1], embedding], axis=-1)

    def step(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, jax.Array]:
        network = {name: value for name, value in params.items() if name != "partners"}
        return super().step(network, carry, self.inputs(params, obs), first)


def _widened(spec: CriticSpec) -> CriticSpec:
    return dataclasses.replace(spec, observation_size=spec.observation_size - 1 + WIDTH)
