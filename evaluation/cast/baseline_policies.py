"""Policies without training: the zero action, uniformly random actions, a task's script."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from assistax_envs.models import build_model
from assistax_envs.own_settings import GENERATOR
from assistax_envs.tasks.chain import script_of
from population.networks.seat import SeatSizes


@dataclasses.dataclass(frozen=True)
class ReferenceSpec(SeatSizes):
    """Seat of the zero and the random policy, whose actions ignore the observation's meaning."""

    def player(self) -> "ReferencePolicy":
        """Return the policy that draws the actions."""
        return ReferencePolicy(self)


@dataclasses.dataclass(frozen=True)
class ScriptSpec(SeatSizes):
    """A task's scripted robot, see `assistax_envs.tasks.chain.Script`."""

    task: str

    def player(self) -> "ScriptedPolicy":
        """Return the policy that plays the script."""
        return ScriptedPolicy(self)


class ReferencePolicy:
    """Policy with actions drawn uniformly from [-amplitude, amplitude].

    The random key is a hash of the observation's bits, so the actions do not depend on how a job is
    cut into chunks.
    """

    def __init__(self, spec: ReferenceSpec) -> None:
        self.spec = spec
        rng = np.random.default_rng(0)
        self._weights = rng.integers(1, 2**32, (2, spec.observation_size), np.uint32) | np.uint32(1)

    def initial_carry(self, batch_shape: tuple[int, ...]) -> tuple[()]:
        """Return the empty carry."""
        return ()

    def act(
        self,
        params: Any,
        carry: tuple[()],
        obs: Float[Array, "*batch O"],
        first: Bool[Array, "*batch"],
    ) -> tuple[tuple[()], Float[Array, "*batch A"]]:
        """Return actions [..., A] for observations [..., O].

        `params` holds a scalar "amplitude".
        """
        rows = jax.lax.bitcast_convert_type(obs, jnp.uint32).reshape(-1, self.spec.observation_size)
        # Integer sums modulo 2**32 are exact in any order.
        words = jnp.sum(rows[:, None, :] * self._weights[None], axis=-1, dtype=jnp.uint32)
        keys = jax.random.wrap_key_data(words, impl=GENERATOR)
        draw = jax.vmap(lambda key: jax.random.uniform(key, (self.spec.action_size,), minval=-1.0))
        actions = draw(keys).reshape(*obs.shape[:-1], self.spec.action_size)
        return carry, params["amplitude"] * actions


class ScriptedPolicy:
    """Policy that plays a task's script, without memory or parameters."""

    def __init__(self, spec: ScriptSpec) -> None:
        self._robot = script_of(spec.task, build_model(spec.task))

    def initial_carry(self, batch_shape: tuple[int, ...]) -> tuple[()]:
        """Return the empty carry."""
        return ()

    def act(
        self,
        params: Any,
        carry: tuple[()],
        obs: Float[Array, "*batch O"],
        first: Bool[Array, "*batch"],
    ) -> tuple[tuple[()], Float[Array, "*batch A"]]:
        """Return actions [..., A] for observations [..., O]."""
        actions = self._robot(obs.reshape(-1, obs.shape[-1]))
        return carry, actions.reshape(*obs.shape[:-1], -1)
