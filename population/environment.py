"""What trainers and rollouts need of an environment."""

from typing import Any, Protocol

import jax

EnvState = Any  # the environment's own state; axis N first in every leaf


class Environment(Protocol):
    """N simulations at once, never mapped over; `assistax_envs.Env` is one."""

    task: str
    backend: str
    version: int
    episode_length: int
    observation_size: dict[str, int]  # by role and "global"
    action_size: dict[str, int]  # by role

    def reset(self, keys: jax.Array, params: Any, /) -> EnvState: ...
    def step(self, state: EnvState, action: dict[str, jax.Array], /) -> EnvState: ...
    def joint_positions(self, state: EnvState, /) -> dict[str, jax.Array]: ...  # rad, by role
