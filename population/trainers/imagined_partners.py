"""Partners of whom some are imagined: in a share of the simulations a model acts."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from assistax_envs import EnvParams
from population.environment import Environment
from population.methods.imagined import LATENT, predicted
from population.networks.members import member_map, to_members, to_simulations
from population.networks.policy import normalise
from population.networks.seat import Params
from population.trainers.frozen_partners import FrozenPartners


class ImaginedPartners(FrozenPartners):
    """Real partners, in place of whom a model acts in a share of the simulations.

    Args:
        real: The real ones; bodies, wishes and seats are theirs.
        share: Of the simulations.
    """

    def __init__(self, real: FrozenPartners, share: float) -> None:
        self.real, self.share, self.role, self.ids = real, share, real.role, real.ids

    def __len__(self) -> int:
        return len(self.real)

    @property
    def params(self) -> Any:
        """Those of the real ones; the model's are its learner's."""
        return self.real.params

    @property
    def numbers(self) -> Any:
        """What describes each real one."""
        return self.real.numbers

    def who(self, humans: Any, num_envs: int) -> jax.Array:
        """Return the places of the real ones [N]."""
        return self.real.who(humans, num_envs)

    def check(self, env: Environment, num_envs: int) -> None:
        """Check that the real ones can act in the environment."""
        self.real.check(env, num_envs)

    def humans(self, num_envs: int, preferences: Sequence[str] = (), member: int = 0) -> EnvParams:
        """Return the humans [N] of a member's simulations."""
        humans = self.real.humans(num_envs, preferences, member)
        return _named(humans, jnp.zeros(num_envs, jnp.int32))

    def renewed(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return the humans [N] of episodes that begin from `keys` [N]."""
        draw = jax.vmap(lambda key: jax.random.randint(jax.random.fold_in(key, 2), (), 0, 2**30))
        renewed = self.real.renewed(humans, keys)
        return renewed if self.numbers is not None else _named(renewed, draw(keys), anew=True)

    def settled(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return humans [N] whose wishes no reset draws anew."""
        return self.real.settled(humans, keys)

    def initial_carry(self, simulations: int) -> Any:
        """Return the real ones' memory; the model has none."""
        return self.real.initial_carry(simulations)

    def imagined(self, simulations: int) -> jax.Array:
        """Return in which simulations [N] the model acts: evenly spread."""
        place = jnp.arange(simulations, dtype=jnp.float32)
        return jnp.floor((place + 1.0) * self.share) > jnp.floor(place * self.share)

    def act(
        self,
        params: Any,
        carry: Any,
        obs: jax.Array,
        first: jax.Array,
        members: int,
        humans: Any = None,
    ) -> tuple[Any, jax.Array]:
        """Return new memories and actions [N, A] of obs [N, O]."""
        real, model = params
        carry, action = self.real.act(real, carry, obs, first, members, humans)
        z = jax.vmap(lambda who: jax.random.normal(jax.random.key(who), (LATENT,)))(humans.person)
        acted = member_map(_imagine)(model, to_members(obs, members), to_members(z, members))
        imagined = self.imagined(len(obs))[:, None]
        return carry, jnp.where(imagined, to_simulations(acted), action)


def _imagine(model: Params, obs: jax.Array, z: jax.Array) -> jax.Array:
    layers = {name: value for name, value in model.items() if name != "normaliser"}
    if "normaliser" in model:
        obs = normalise(model["normaliser"], obs)
    return predicted(layers, obs, z)


def _named(humans: EnvParams, names: jax.Array, *, anew: bool = False) -> EnvParams:
    """Give humans [N] without a number one, from which their latents are drawn."""
    if humans.person is not None and not anew:
        return humans
    return dataclasses.replace(humans, person=names)
