"""Frozen partners in rotation: each simulation meets the next one in its next episode."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from assistax_envs import EnvParams, disability_params
from population.partners.frozen import FrozenPartners


@dataclasses.dataclass(frozen=True)
class RotatingPartners:
    """Partners in rotation, as the vector adapters of `assistax_envs.adapters` take them.

    P partners have ceil(N / P) seats each, in a ring. N simulations in a row sit in it; with every
    episode all move on by one partner. So a simulation meets every partner once in P episodes, and
    every partner plays equally often, while its network still reads one block of observations. A
    few seats stay empty where P does not divide N.
    """

    frozen: FrozenPartners
    preferences: Sequence[str] = ()  # one is drawn for each episode; of these, or of all

    @property
    def params(self) -> Any:
        """Their parameters, as `act` takes them."""
        return self.frozen.params

    def begin(self, params: Any, key: jax.Array, before: Any, n: int) -> tuple[Any, EnvParams]:
        """Move on by one partner, from a random place at first; see `adapters.partners.Partners`.

        Who sits there is the place [] of the first simulation in the ring, and the carries.
        """
        del params
        of_place, of_preferences = jax.random.split(key)
        seats, share = self._seats(n), self._seats(n) // len(self.frozen)
        if before is None:
            place = jax.random.randint(of_place, (), 0, seats)
        else:
            place = (before[0] + share) % seats
        humans = self.frozen.humans(seats)
        humans = jax.tree.map(lambda leaf: jnp.roll(leaf, -place)[:n], humans)
        if self.preferences:
            names = self.preferences
            codes = disability_params(["d1"] * len(names), names).preference_code
            drawn = jax.random.randint(of_preferences, (n,), 0, len(names))
            humans = dataclasses.replace(humans, preference_code=codes[drawn])
        return (place, self.frozen.initial_carry(seats)), humans

    def act(
        self, params: Any, seated: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        """Return the new carries and the actions [N, A] for obs [N, O]."""
        place, carry = seated
        n = obs.shape[0]
        filled = jnp.arange(self._seats(n)) % n  # empty seats see what somebody else sees
        obs, first = (jnp.roll(leaf[filled], place, axis=0) for leaf in (obs, first))
        carry, action = self.frozen.act(params, carry, obs, first, members=1)
        return (place, carry), jnp.roll(action, -place, axis=0)[:n]

    def word(self, seated: Any, n: int) -> jax.Array | None:
        """Return the words [N] that they said with their last actions; None if nobody speaks."""
        place, carry = seated
        said = self.frozen.words(carry, members=1)
        return None if said is None else jnp.roll(said, -place)[:n]

    def names(self, seated: Any, n: int) -> list[str]:
        """Return the id of each simulation's partner."""
        seats = self._seats(n)
        share, place = seats // len(self.frozen), int(seated[0])
        return [self.frozen.ids[(place + row) % seats // share] for row in range(n)]

    def _seats(self, n: int) -> int:
        return len(self.frozen) * math.ceil(n / len(self.frozen))
