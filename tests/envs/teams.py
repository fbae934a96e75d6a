"""Published teams as fixed policies for tests of the environment; the tests may look into the
layers above.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from assistax_envs import EnvState
from population.networks.policy import Policy
from zoo.parameters.storage import load_stacks
from zoo.registry import load_registry

Players = Callable[
    [EnvState, jax.Array], dict[str, jax.Array]
]  # from a state and the time to both roles' actions


def team(identifier: str, size: int) -> Players:
    """Return a team of the installed registry as players of `size` simulations."""
    registry = load_registry()
    players = {}
    for role in ("robot", "human"):
        group = load_stacks(registry, registry.select(f"{identifier}/{role}"))[0]
        players[role] = Policy(group.spec), jax.tree.map(lambda leaf: leaf[0], group.params)
    first = jnp.zeros(size, bool)

    def act(state: EnvState, time: jax.Array) -> dict[str, jax.Array]:
        return {
            role: policy.act(params, policy.initial_carry((size,)), state.obs[role], first)[1]
            for role, (policy, params) in players.items()
        }

    return act


def random_players(size: int, hold: int, seed: int) -> Players:
    """Return players of full torques whose signs are drawn anew every `hold` steps."""

    def act(state: EnvState, time: jax.Array) -> dict[str, jax.Array]:
        signs = jax.random.rademacher(
            jax.random.fold_in(jax.random.key(seed), time // hold), (size, 10), jnp.float32
        )
        return {"robot": signs[:, :7], "human": signs[:, 7:]}

    return act
