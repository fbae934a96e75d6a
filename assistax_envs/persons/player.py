"""Persons as players of the human's seat, in the form of a policy."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.humans import EnvParams
from assistax_envs.models import build_model
from assistax_envs.own_settings import LANES, own_settings
from assistax_envs.persons.controller import Controller
from assistax_envs.persons.head import Head
from assistax_envs.persons.rows import WIDTH, index
from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.gentle_base import Preferences

_STREAM = 2**31 - 2  # folded into an episode's key to draw a person: the start is drawn from it too


class PersonPlayer:
    """All persons of a task and a family, in `population.networks.policy.Policy`'s form."""

    def __init__(self, task: str, family: str = "spring") -> None:
        made = Head if REGISTERED[task].seat == "mouth" else Controller
        self.controller: Any = made(task, build_model(task), family)

    @own_settings()
    def initial_carry(self, batch_shape: tuple[int, ...]) -> Any:
        """Return the carry before the first observation, leaves [*batch_shape, ...]."""
        mind = self.controller.initial(math.prod(batch_shape))
        return jax.tree.map(lambda leaf: leaf.reshape(*batch_shape, *leaf.shape[1:]), mind)

    @own_settings()
    def act(
        self, params: Any, carry: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        """Return the carry and the actions [..., 3], at the mouth 5, for observations [..., O].

        `params` holds "row", [30] of one person or [..., 30] of as many as there are observations:
        thousands of persons need no map.
        """
        shape = obs.shape[:-1]
        n = math.prod(shape)
        row, first = (
            jnp.broadcast_to(params["row"], (*shape, WIDTH)),
            jnp.broadcast_to(first, shape),
        )

        def flat(leaf: jax.Array) -> jax.Array:
            leaf = leaf.reshape(n, *leaf.shape[len(shape) :])
            more = -n % LANES
            return jnp.concatenate([leaf, *[leaf[:1]] * more]) if more else leaf

        given = jax.tree.map(flat, (row, carry, obs, first))
        mind, action = self.controller.act(*given)
        return jax.tree.map(lambda leaf: leaf[:n].reshape(*shape, *leaf.shape[1:]), (mind, action))

    def word(self, carry: Any) -> jax.Array:
        """Return the words [...] int32 that persons say in the step of `act`; 0 for silence."""
        return carry.signs.word

    def act_stack(
        self, params: Any, carry: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        """Act for stacked persons, "row" [P, 30] and obs [P, R, O]: at once, without a map."""
        return self.act({"row": params["row"][:, None]}, carry, obs, first)


@own_settings()
def draw_persons(keys: jax.Array, numbers: np.ndarray | jax.Array) -> jax.Array:
    """Draw a person for each episode from its key [N]: numbers [N] among `numbers`.

    The same key draws the same person, whatever else is drawn from it. `person_params` of their
    rows is the human that the environment is reset with, and "row" is what `PersonPlayer` acts by.
    """

    def draw(key: jax.Array) -> jax.Array:
        return jax.random.randint(jax.random.fold_in(key, _STREAM), (), 0, len(numbers))

    return jnp.asarray(numbers)[jax.vmap(draw)(keys)]


@own_settings()
def person_params(task: str, rows: np.ndarray | jax.Array) -> EnvParams:
    """Return the humans [N] of persons with rows [N, 30]: their bodies and preferences.

    Strength and tremor are the person's own, and not taken twice.
    """
    place, n = index(task), len(rows)
    column = {name: jnp.asarray(rows[:, where]) for name, where in place.items()}
    one = jnp.ones(n, jnp.float32)
    names = (field.name for field in dataclasses.fields(Preferences))
    preference = Preferences(*(column.get(f"liked_{name}", one) for name in names))
    return EnvParams(
        strength=one,
        elbow_range=column["range"],
        tremor=jnp.zeros(n, jnp.float32),
        preference_code=jnp.zeros(n, jnp.int32),
        preference=preference,
    )
