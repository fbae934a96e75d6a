"""Action of a seat's policies: stacks of them, each for its rows, with noise or without.

G policies of a seat have R simulations each: see the drawing of `Layout`.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from assistax_envs.own_settings import LANES
from population.networks.members import member_map
from population.networks.seat import Carry, Params
from population.play.layout import Layout

# Folded into an episode's key for action noise, since the environment draws from the key itself.
_ACTION_STREAM = 2**31 - 1


def act_all(
    policies: Sequence[Any],
    params: Sequence[Params],
    carries: Sequence[Carry],
    obs: Float[Array, "G R O"],
    first: Bool[Array, ""] | bool,
    keys: Key[Array, "G R"] | None,
) -> tuple[tuple[Carry, ...], Float[Array, "G R A"]]:
    """Return the new carries and actions of a seat's stacks, each for its own rows."""
    starts = itertools.accumulate(widths(params), initial=0)
    acted = [
        _act(
            policy, stack, carry, obs[start:stop], first, None if keys is None else keys[start:stop]
        )
        for policy, stack, carry, (start, stop) in zip(
            policies, params, carries, itertools.pairwise(starts), strict=True
        )
    ]
    return tuple(carry for carry, _ in acted), jnp.concatenate([action for _, action in acted])


def said(
    policies: Sequence[Any], params: Sequence[Params], carries: Sequence[Carry], rows: int
) -> jax.Array | None:
    """Return the words [G, R] int32 of a seat's stacks after acting; None if no stack speaks."""
    if not any(hasattr(policy, "word") for policy in policies):
        return None
    words = [
        policy.word(carry) if hasattr(policy, "word") else jnp.zeros((count, rows), jnp.int32)
        for policy, carry, count in zip(policies, carries, widths(params), strict=True)
    ]
    return jnp.concatenate(words)


def _act(
    policy: Any,
    params: Params,
    carry: Carry,
    obs: Float[Array, "G R O"],
    first: Bool[Array, ""] | bool,
    keys: Key[Array, "G R"] | None,
) -> tuple[Carry, Float[Array, "G R A"]]:
    """Return carry and actions of stacked policies: drawn if keys are given, else the mode."""
    rows = obs.shape[1]
    filled = _filled(policy, rows)
    obs = jnp.pad(obs, ((0, 0), (0, filled - rows), (0, 0)), mode="edge")
    first = jnp.broadcast_to(first, obs.shape[:2])
    if keys is None or not hasattr(policy, "step"):  # no distribution to draw from
        act = getattr(policy, "act_stack", None) or member_map(policy.act)
        carry, action = act(params, carry, obs, first)
        return carry, action[:, :rows]
    carry, gaussian = member_map(policy.step)(params, carry, obs, first)
    keys = keys[:, jnp.minimum(jnp.arange(filled), rows - 1)]
    draw = jax.vmap(jax.vmap(lambda gaussian, key: gaussian.sample(key)))
    action = gaussian.action(draw(gaussian, keys))
    return policy.acted(carry, action), action[:, :rows]


def noise_keys(
    keys: Key[Array, "*P K"], time: jax.Array, layout: Layout
) -> tuple[Key[Array, "G R"], Key[Array, "H S"]]:
    """Return the keys of the robots' rows and of the humans' at a step.

    They derive from the episode's key, apart from the environment's stream, so that every pair of
    an episode sees the same noise.
    """
    e, p, k = layout.block

    def keys_of(role: int) -> Key[Array, "P K"]:
        streams = (_ACTION_STREAM, role, time)
        flat = jax.vmap(lambda key: functools.reduce(jax.random.fold_in, streams, key))(
            keys.ravel()
        )
        return jnp.broadcast_to(flat.reshape(keys.shape), (p, k))

    robot, human = keys_of(0), keys_of(1)
    if not layout.paired:
        robot = jnp.broadcast_to(robot.reshape(1, p * k), (e, p * k))
    return robot, jnp.broadcast_to(human[:, None], (p, e, k)).reshape(p, e * k)


def initial_carries(policies: Sequence[Any], counts: Sequence[int], rows: int) -> tuple[Carry, ...]:
    """Return each stack's recurrent state at the start, leaves [G, R, ...]."""
    return tuple(
        policy.initial_carry((count, _filled(policy, rows)))
        for policy, count in zip(policies, counts, strict=True)
    )


def widths(params: Sequence[Params]) -> tuple[int, ...]:
    """Return the number of policies in each stack of parameters."""
    return tuple(jax.tree.leaves(stack)[0].shape[0] for stack in params)


def _filled(policy: Any, rows: int) -> int:
    """Return the rows with which a policy acts for `rows` simulations: its last ones are copies.

    A CPU rounds the rows that do not fill a vector in another way, so values would depend on the
    block. Players that act for a stack at once see to that themselves.
    """
    return rows if hasattr(policy, "act_stack") else rows + -rows % LANES
