"""Persons as partners of an ego: the key of each episode draws one."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from assistax_envs import EnvParams
from assistax_envs.persons import PersonPlayer, draw_persons, person_params
from assistax_envs.persons.rows import WIDTH
from assistax_envs.persons.senses import SEAT_SIZES
from population.environment import Environment
from population.partners.frozen import FrozenPartners


class DrawnPersons(FrozenPartners):
    """Persons, one drawn for each episode by its key; a resumed run meets the same ones.

    Who is in a simulation stands in its `EnvParams`, as a place among the rows.

    Args:
        player: Acts for them.
        rows: All of them [P, 31], as `assistax_envs.persons.rows.marked` has them.
        name: What they are called together, such as the id of their split.
    """

    def __init__(self, player: PersonPlayer, rows: Float[jax.Array, "P W"], name: str) -> None:
        self.role, self.player, self.rows, self.ids = "human", player, jnp.asarray(rows), (name,)

    @property
    def params(self) -> jax.Array:
        """Their rows, as `act` takes them."""
        return self.rows

    def check(self, env: Environment, num_envs: int) -> None:
        """Check that they are of the environment's task.

        Raises:
            ValueError: They are not.
        """
        task = self.player.controller.task
        if env.task != task:
            raise ValueError(f"persons of {task} cannot sit in {env.task}; give those of its task")

    def humans(self, num_envs: int, preferences: Sequence[str] = (), member: int = 0) -> EnvParams:
        """Return the first person [N] in all simulations: `renewed` draws where episodes begin.

        Raises:
            ValueError: Preferences are given, and persons have their own.
        """
        if preferences:
            raise ValueError("persons have their own preferences; leave preferences out")
        return self._of(jnp.zeros(num_envs, jnp.int32))

    def renewed(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return the humans of the episodes that begin from `keys` [N]."""
        return self._of(draw_persons(keys, jnp.arange(len(self.rows), dtype=jnp.int32)))

    def settled(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return the humans [N]: their preferences are their own."""
        return humans

    def sharing(self, split: str, size: int, envs: int, preset: int, preferences: Any) -> str:
        """Return in a line whom the simulations meet; see `FrozenPartners.sharing`."""
        return f"a new person each episode, of the {size} of {split}"

    @property
    def numbers(self) -> np.ndarray:
        """Their rows [P, 30]."""
        return np.asarray(self.rows)[:, :WIDTH]

    def who(self, humans: Any, num_envs: int) -> jax.Array:
        """Return the places among them [N] of those in the simulations."""
        return humans.person

    def initial_carry(self, simulations: int) -> Any:
        """Return their minds before the first observation, [N, ...]."""
        return self.player.initial_carry((simulations,))

    def member_axes(self, carry: Any) -> Any:
        """Return the axes of members: minds lie as simulations do, since persons change."""
        return jax.tree.map(lambda _: 0, carry)

    def act(
        self,
        params: jax.Array,
        carry: Any,
        obs: jax.Array,
        first: jax.Array,
        members: int,
        humans: Any = None,
    ) -> tuple[Any, jax.Array]:
        """Return new minds and actions [N, A] of obs [N, O]."""
        return self.player.act({"row": params[humans.person]}, carry, obs, first)

    def words(self, carry: Any, members: int) -> jax.Array | None:
        """Return the words [N] int32 that they said with their last actions."""
        return self.player.word(carry)

    def _of(self, places: jax.Array) -> EnvParams:
        humans = person_params(self.player.controller.task, self.rows[places])
        return dataclasses.replace(humans, person=places)


class IdlePersons(DrawnPersons):
    """The same persons with body and preferences, but idle."""

    def act(
        self,
        params: jax.Array,
        carry: Any,
        obs: jax.Array,
        first: jax.Array,
        members: int,
        humans: Any = None,
    ) -> tuple[Any, jax.Array]:
        """Return the carries and no torques [N, A]."""
        return carry, jnp.zeros((len(obs), SEAT_SIZES[self.player.controller.task][1]), obs.dtype)

    def words(self, carry: Any, members: int) -> None:
        """Return None: they say nothing."""


class OnePersonEach(DrawnPersons):
    """Member i learns with person i alone: best responses to all of them, in one program."""

    def humans(self, num_envs: int, preferences: Sequence[str] = (), member: int = 0) -> EnvParams:
        """See `FrozenPartners.humans`.

        Raises:
            ValueError: There is no person for that member.
        """
        if member >= len(self.rows):
            raise ValueError(f"member {member} has no person; there are {len(self.rows)} of them")
        return self._of(jnp.full(num_envs, member, jnp.int32))

    def renewed(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """See `FrozenPartners.renewed`: the humans stay."""
        return humans
