"""Frozen partners of an ego's training, which act in the other seat."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_base.errors import counted
from assistax_envs import EnvParams, disability_params
from assistax_envs.disability import Disability
from assistax_envs.tasks.gentle_base import draw_preferences
from population.environment import Environment
from population.networks.members import member_map
from population.networks.seat import Carry, Player
from population.networks.stack import PolicyStack


class FrozenPartners:
    """Partners that act by their most likely action, each in the same number of simulations.

    A member's simulations are laid out [partner, simulation], so that a partner's network reads one
    block of all members' simulations: no parameters are gathered, and nobody acts where another
    does.

    Args:
        stacks: The partners by spec.
        settings: The disability setting of each, by id.

    Raises:
        ValueError: There is none, not all sit in the same seat, or a setting is missing.
    """

    def __init__(self, stacks: Sequence[PolicyStack], settings: Mapping[str, Disability]) -> None:
        roles = {stack.spec.role for stack in stacks}
        if len(roles) != 1:
            raise ValueError(
                f"partners are of roles {sorted(roles)}; give partners that all sit in the same "
                "seat"
            )
        self.role: str = next(iter(roles))
        self.stacks = tuple(stacks)
        self.ids = tuple(name for stack in stacks for name in stack.ids)
        if missing := [name for name in self.ids if name not in settings]:
            raise ValueError(f"partner {missing[0]} has no disability setting; give one for each")
        self._settings = tuple(settings[name] for name in self.ids)
        self._policies = tuple(stack.spec.player() for stack in stacks)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def params(self) -> Any:
        """Their parameters, as `act` takes them."""
        return tuple(jax.tree.map(jnp.asarray, stack.params) for stack in self.stacks)

    def check(self, env: Environment, num_envs: int) -> None:
        """Check that they can act in the environment, each in an equal share of the simulations.

        Raises:
            ValueError: They cannot.
        """
        for stack in self.stacks:
            sizes = stack.spec.observation_size, stack.spec.action_size
            seats = env.observation_size[self.role], env.action_size[self.role]
            if sizes != seats:
                raise ValueError(
                    f"partner {stack.ids[0]} has observation and action size {sizes}; those of "
                    f"the {self.role} in {env.task} are {seats}: give partners of this task and "
                    "environment version"
                )
        if num_envs % len(self):
            fitting = fitting_envs(num_envs, len(self))
            raise ValueError(
                f"num_envs is {num_envs} with {len(self)} partners; every partner gets the same "
                f"share, so choose a multiple of {len(self)}, such as {fitting}"
            )

    def settings(self, num_envs: int) -> list[Disability]:
        """Return the disability setting of each simulation of a member."""
        return [setting for setting in self._settings for _ in range(num_envs // len(self))]

    def preferences_in_turns(self, num_envs: int, preferences: Sequence[str]) -> list[str]:
        """Return the preference of each simulation of a member; preferences take turns.

        Each partner begins with another preference, so that few simulations of many partners have
        all preferences equally often.
        """
        share = num_envs // len(self)
        return [
            preferences[(partner + turn) % len(preferences)]
            for partner in range(len(self))
            for turn in range(share)
        ]

    def humans(self, num_envs: int, preferences: Sequence[str] = (), member: int = 0) -> EnvParams:
        """Return the humans [N] of a member's simulations; without preferences they are drawn."""
        names = self.preferences_in_turns(num_envs, preferences) if preferences else None
        return disability_params(self.settings(num_envs), names)

    def renewed(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return the humans [N] of episodes that begin from `keys` [N]: the same as before."""
        return humans

    def settled(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return humans [N] whose preferences no reset draws anew; keys [N] draw the open ones."""
        return dataclasses.replace(
            humans, preference=jax.vmap(draw_preferences)(humans.preference_code, keys)
        )

    def sharing(self, split: str, size: int, envs: int, preset: int, preferences: Any) -> str:
        """Return in a line how simulations are shared out.

        Args:
            split: Id of the split whose training side the partners are.
            size: Partners of that side.
            envs: Simulations of a member.
            preset: Simulations of a member in the preset.
            preferences: Names of the humans' preferences; empty if they are drawn.
        """
        names = ", ".join(preferences)
        line = (
            f"{counted(len(self), 'partner')} of {split}{names and f' under {names}'}, "
            f"{counted(envs // len(self), 'simulation')} each"
        )
        return line if envs == preset else f"{line}, {envs} in place of the preset's {preset}"

    @property
    def numbers(self) -> np.ndarray | None:
        """Numbers that describe each partner [P, W]; None for networks, which have only a place."""
        return None

    def who(self, humans: Any, num_envs: int) -> jax.Array:
        """Return the places among them [N] of the partners in members' simulations."""
        simulations = jax.tree.leaves(humans)[0].shape[0]
        return jnp.arange(simulations) % num_envs // (num_envs // len(self))

    def initial_carry(self, simulations: int) -> tuple[Carry, ...]:
        """Return carries before the first observation, by stack [P, N / partners, ...]."""
        share = simulations // len(self)
        return tuple(policy.initial_carry((len(stack), share)) for policy, stack in self._pairs())

    def member_axes(self, carry: Any) -> Any:
        """Return the axis along which members lie in each leaf of `initial_carry`."""
        return jax.tree.map(lambda _: 1, carry)

    def act(
        self,
        params: Any,
        carry: tuple[Carry, ...],
        obs: jax.Array,
        first: jax.Array,
        members: int,
        humans: Any = None,
    ) -> tuple[tuple[Carry, ...], jax.Array]:
        """Return new carries and actions [N, A] of obs [N, O], whoever the `humans` [N] are.

        N is [member, partner, simulation].
        """
        count = len(self)
        obs, first = (_by_partner(leaf, members, count) for leaf in (obs, first))
        carries, actions, start = [], [], 0
        for index, (policy, stack) in enumerate(self._pairs()):
            block = slice(start, start := start + len(stack))
            new, action = member_map(policy.act)(
                params[index], carry[index], obs[block], first[block]
            )
            carries.append(new)
            actions.append(action)
        action = jnp.concatenate(actions).reshape(count, members, -1, actions[0].shape[-1])
        return tuple(carries), jnp.moveaxis(action, 1, 0).reshape(-1, action.shape[-1])

    def words(self, carry: Any, members: int) -> jax.Array | None:
        """Return the words [N] int32 said with their last actions; None if none of them speaks."""
        speak: list[Any] = [getattr(policy, "word", None) for policy in self._policies]
        rows = jax.tree.leaves(carry)
        if not rows or not any(speak):
            return None
        silence = [jnp.zeros((len(stack), rows[0].shape[1]), jnp.int32) for stack in self.stacks]
        said = jnp.concatenate(
            [
                word(own) if word else none
                for word, own, none in zip(speak, carry, silence, strict=True)
            ]
        )
        said = said.reshape(len(self), members, -1)
        return jnp.moveaxis(said, 1, 0).reshape(-1).astype(jnp.int32)

    def _pairs(self) -> list[tuple[Player, PolicyStack]]:
        return list(zip(self._policies, self.stacks, strict=True))


class PartnersWithBodies(FrozenPartners):
    """Frozen partners whose specs give bodies and preferences of their own."""

    def humans(self, num_envs: int, preferences: Sequence[str] = (), member: int = 0) -> EnvParams:
        """Return the humans [N] of a member's simulations.

        Raises:
            ValueError: Preferences are given.
        """
        if preferences:
            raise ValueError("the partners have their own preferences; leave preferences out")
        settings, parts = iter(self._settings), []
        for stack in self.stacks:
            bodies = [next(settings) for _ in stack.ids]
            parts.append(stack.spec.humans(stack.params, bodies, None))
        humans = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
        share = num_envs // len(self)
        return jax.tree.map(lambda leaf: jnp.repeat(leaf, share, axis=0), humans)

    def settled(self, humans: EnvParams, keys: jax.Array) -> EnvParams:
        """Return the humans [N]: their preferences are their own."""
        return humans


def fitting_envs(num_envs: int, partners: int, minibatches: int = 1) -> int:
    """Return the number of simulations, nearest to `num_envs`, that can be shared out equally.

    With more partners than simulations this is one for each partner, or a few where minibatches ask
    for it.
    """
    unit = math.lcm(partners, minibatches)
    return max(1, round(num_envs / unit)) * unit


def _by_partner(leaf: jax.Array, members: int, partners: int) -> jax.Array:
    """Turn [member x partner x simulation, ...] into [partner, member x simulation, ...]."""
    leaf = jnp.moveaxis(leaf.reshape(members, partners, -1, *leaf.shape[1:]), 1, 0)
    return leaf.reshape(partners, -1, *leaf.shape[3:])
