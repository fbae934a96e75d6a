"""Persons and teams' humans as partners of one training, each in half of the simulations."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_base.errors import counted
from assistax_envs import EnvParams
from assistax_envs.tasks.gentle_base import draw_preferences
from population.environment import Environment
from population.partners.drawn_persons import DrawnPersons
from population.partners.frozen import FrozenPartners


class MixedPartners(FrozenPartners):
    """Persons in the first half of a member's simulations, and networks in the second.

    A person is drawn for each episode. Each network has the same number of simulations, and one of
    the nine preferences is drawn for each of its episodes.

    Args:
        persons: The persons.
        teams: The networks.

    Raises:
        ValueError: The networks do not sit in the human's seat.
    """

    def __init__(self, persons: DrawnPersons, teams: FrozenPartners) -> None:
        if teams.role != persons.role:
            raise ValueError(f"networks are of role {teams.role}; give those of {persons.role}s")
        self.role, self._persons, self._teams = persons.role, persons, teams
        self.ids = (*persons.ids, *teams.ids)

    def __len__(self) -> int:
        """Return the number of equal shares: a network has one, and persons have half of all."""
        return 2 * len(self._teams)

    @property
    def params(self) -> Any:
        """Their parameters, as `act` takes them."""
        return self._persons.params, self._teams.params

    def check(self, env: Environment, num_envs: int) -> None:
        """Check that they can act in the environment, in equal shares; see `FrozenPartners.check`.

        Raises:
            ValueError: They cannot.
        """
        if num_envs % len(self):
            raise ValueError(
                f"num_envs is {num_envs} with {counted(len(self._teams), 'network')} in half of "
                f"the simulations; choose a multiple of {len(self)}"
            )
        self._persons.check(env, num_envs // 2)
        self._teams.check(env, num_envs // 2)

    def humans(self, num_envs: int, preferences: Sequence[str] = (), member: int = 0) -> EnvParams:
        """Return the humans [N] of a member's simulations, before `renewed` draws.

        Raises:
            ValueError: Preferences are given, and persons have their own.
        """
        half = num_envs // 2
        persons, teams = self._persons.humans(half, preferences), self._teams.humans(half)
        return jax.tree.map(
            lambda *leaves: jnp.concatenate(leaves),
            persons,
            dataclasses.replace(
                teams,
                preference=persons.preference,
                person=len(self._persons.rows) + self._teams.who(teams, half),
            ),
        )

    def renewed(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return the humans of the episodes that begin from `keys` [N]."""
        network = humans.person >= len(self._persons.rows)
        drawn = jax.vmap(draw_preferences)(humans.preference_code, keys)
        # The width of their liking is the training's, which sets it anew.
        same = dataclasses.replace(humans, preference=drawn, width=None)
        return jax.tree.map(
            lambda kept, new: jnp.where(network, kept, new),
            same,
            self._persons.renewed(humans, keys),
        )

    def settled(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return the humans [N]: `renewed` has drawn their preferences."""
        return humans

    def sharing(self, split: str, size: int, envs: int, preset: int, preferences: Any) -> str:
        """Return in a line how simulations are shared out; see `FrozenPartners.sharing`."""
        persons = size - len(self._teams)
        each = counted(envs // len(self), "simulation")
        return (
            f"{self._persons.sharing(split, persons, envs, preset, ())} in half of {envs} "
            f"simulations; {counted(len(self._teams), 'team')}, {each} each"
        )

    @property
    def numbers(self) -> np.ndarray:
        """Numbers that describe each partner [P, W]: a person's rows, and a network's place.

        A network has the persons' mean in their columns, and a column of its own.
        """
        rows = self._persons.numbers
        count = len(self._teams)
        means = np.broadcast_to(rows.mean(axis=0), (count, rows.shape[1]))
        places = np.eye(count, dtype=rows.dtype)
        absent = np.zeros((len(rows), count), rows.dtype)
        return np.block([[rows, absent], [means, places]])

    def who(self, humans: Any, num_envs: int) -> jax.Array:
        """Return the places among them [N] of those in the simulations; persons come first."""
        return humans.person

    def initial_carry(self, simulations: int) -> tuple[Any, Any]:
        """Return the persons' minds and the networks' carries before the first observation."""
        half = simulations // 2
        return self._persons.initial_carry(half), self._teams.initial_carry(half)

    def member_axes(self, carry: Any) -> Any:
        """Return the axis along which members lie in each leaf; see `FrozenPartners`."""
        return self._persons.member_axes(carry[0]), self._teams.member_axes(carry[1])

    def act(
        self,
        params: Any,
        carry: Any,
        obs: jax.Array,
        first: jax.Array,
        members: int,
        humans: Any = None,
    ) -> tuple[Any, jax.Array]:
        """Return new minds and carries, and actions [N, A] of obs [N, O] of `humans` [N]."""
        one, other = (_half((obs, first, humans), members, place) for place in (0, 1))
        minds, moved = self._persons.act(params[0], carry[0], one[0], one[1], members, one[2])
        carries, acted = self._teams.act(params[1], carry[1], other[0], other[1], members, other[2])
        return (minds, carries), _joined(moved, acted, members)

    def words(self, carry: Any, members: int) -> jax.Array | None:
        """Return the words [N] int32 said with their last actions; networks are silent."""
        said = self._persons.words(carry[0], members)
        return None if said is None else _joined(said, jnp.zeros_like(said), members)


def _half(tree: Any, members: int, place: int) -> Any:
    """Return one half of each member's simulations, of leaves [N, ...]."""

    def of(leaf: jax.Array) -> jax.Array:
        return leaf.reshape(members, 2, -1, *leaf.shape[1:])[:, place].reshape(-1, *leaf.shape[1:])

    return jax.tree.map(of, tree)


def _joined(one: jax.Array, other: jax.Array, members: int) -> jax.Array:
    """Return an array [N, ...] of the two halves of each member's simulations."""
    halves = [leaf.reshape(members, -1, *leaf.shape[1:]) for leaf in (one, other)]
    return jnp.concatenate(halves, axis=1).reshape(-1, *one.shape[1:])
