"""Frozen partners of an ego's training: who acts in the other seat."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from assistax_envs.disability import Disability
from population.mapping import member_map
from population.networks import Carry
from population.policy import Policy
from population.spec import PolicySpec


class PartnerEnvironment(Protocol):
    """What a population is held against: the widths of an environment."""

    task: str
    observation_size: dict[str, int]
    action_size: dict[str, int]


@dataclasses.dataclass(frozen=True)
class PartnerGroup:
    """Partners of one spec, stacked."""

    spec: PolicySpec
    names: tuple[str, ...]  # [P]
    disabilities: tuple[str | Disability, ...]  # of each [P]
    params: Any  # leaves [P, ...]


class Partners:
    """Partners who act with their most likely action, each in the same number of simulations.

    A member's simulations are laid out [partner, simulation], so that a partner's network reads one
    block of all members' simulations: no parameters are gathered, and nobody acts where another
    does.

    Args:
        groups: The partners by spec.

    Raises:
        ValueError: There is none, or not all sit in the same seat.
    """

    def __init__(self, groups: Sequence[PartnerGroup]) -> None:
        roles = {group.spec.role for group in groups}
        if len(roles) != 1:
            raise ValueError(
                f"partners are of roles {sorted(roles)}; give partners that all sit in the same "
                "seat"
            )
        self.role: str = next(iter(roles))
        self.groups = tuple(groups)
        self.names = tuple(name for group in groups for name in group.names)
        self.disabilities = tuple(setting for group in groups for setting in group.disabilities)
        self._policies = tuple(Policy(group.spec) for group in groups)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def params(self) -> Any:
        """Their parameters, as `act` takes them."""
        return tuple(jax.tree.map(jnp.asarray, group.params) for group in self.groups)

    def check(self, env: PartnerEnvironment, num_envs: int) -> None:
        """Check that they can act in the environment, each in an equal share of the simulations.

        Raises:
            ValueError: They cannot.
        """
        for group in self.groups:
            found = group.spec.observation_size, group.spec.action_size
            wanted = env.observation_size[self.role], env.action_size[self.role]
            if found != wanted:
                raise ValueError(
                    f"partner {group.names[0]} has observation and action size {found}; those of "
                    f"the {self.role} in {env.task} are {wanted}: give partners of this task and "
                    "environment version"
                )
        if num_envs % len(self):
            fitting = fitting_envs(num_envs, len(self))
            raise ValueError(
                f"num_envs is {num_envs} with {len(self)} partners; every partner gets the same "
                f"share, so choose a multiple of {len(self)}, such as {fitting}"
            )

    def settings(self, num_envs: int) -> list[str | Disability]:
        """Return the disability setting of each simulation of a member."""
        return [setting for setting in self.disabilities for _ in range(num_envs // len(self))]

    def initial_carry(self, simulations: int) -> tuple[Carry, ...]:
        """Return carries before the first observation, by group [P, N / partners, ...]."""
        share = simulations // len(self)
        return tuple(
            policy.initial_carry((len(group.names), share)) for policy, group in self._pairs()
        )

    def act(
        self, params: Any, carry: tuple[Carry, ...], obs: jax.Array, first: jax.Array, members: int
    ) -> tuple[tuple[Carry, ...], jax.Array]:
        """Return the new carries and the actions [N, A] of obs [N, O], where N is [member, partner, simulation]."""
        count = len(self)
        obs, first = (_by_partner(leaf, members, count) for leaf in (obs, first))
        carries, actions, start = [], [], 0
        for index, (policy, group) in enumerate(self._pairs()):
            block = slice(start, start := start + len(group.names))
            new, action = member_map(policy.act)(
                params[index], carry[index], obs[block], first[block]
            )
            carries.append(new)
            actions.append(action)
        action = jnp.concatenate(actions).reshape(count, members, -1, actions[0].shape[-1])
        return tuple(carries), jnp.moveaxis(action, 1, 0).reshape(-1, action.shape[-1])

    def _pairs(self) -> list[tuple[Policy, PartnerGroup]]:
        return list(zip(self._policies, self.groups, strict=True))


def fitting_envs(num_envs: int, partners: int, minibatches: int = 1) -> int:
    """Return the number of simulations, nearest to one, of which partners and minibatches have equal shares.

    With more partners than simulations this is one for each partner, or a few where minibatches ask
    for it.
    """
    unit = math.lcm(partners, minibatches)
    return max(1, round(num_envs / unit)) * unit


def _by_partner(leaf: jax.Array, members: int, partners: int) -> jax.Array:
    """Turn [member x partner x simulation, ...] into [partner, member x simulation, ...]."""
    leaf = jnp.moveaxis(leaf.reshape(members, partners, -1, *leaf.shape[1:]), 1, 0)
    return leaf.reshape(partners, -1, *leaf.shape[3:])
