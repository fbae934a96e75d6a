"""Persons as players of the human's seat, in the form of a policy."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_base.extensions import files_sha256
from assistax_envs.humans import EnvParams
from assistax_envs.models import build_model
from assistax_envs.own_settings import LANES, own_settings
from assistax_envs.persons.controller import Controller
from assistax_envs.persons.head import Head
from assistax_envs.persons.rows import (
    WIDTH,
    check_files,
    index,
    installed_family,
    marked,
    persons,
)
from assistax_envs.persons.senses import SEAT_SIZES
from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.gentle_base import Preferences

_STREAM = 2**31 - 2  # folded into an episode's key to draw a person: the start is drawn from it too


class PersonPlayer:
    """All persons of a task, in `population.networks.policy.Policy`'s form."""

    def __init__(self, task: str, own: str = "", files: str = "") -> None:
        """Prepare to play.

        Args:
            task: The task.
            own: Name of an installed package's family, whose program plays alone.
            files: sha256 that this package's files must have.

        Raises:
            ValueError: No such package is installed, or its files are others.
        """
        made: Any = Head if REGISTERED[task].seat == "mouth" else Controller
        made = _load_family(own, files) if own else made
        self.controller: Any = made(task, build_model(task))

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

        `params` holds "row" as `rows.marked` has it, [31] of one person or [..., 31] of as many as
        there are observations: thousands of persons need no map.
        """
        shape = obs.shape[:-1]
        n = math.prod(shape)
        row, first = (
            jnp.broadcast_to(params["row"], (*shape, WIDTH + 1)),
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
        """Act for stacked persons, "row" [P, 31] and obs [P, R, O]: at once, without a map."""
        return self.act({"row": params["row"][:, None]}, carry, obs, first)


@functools.cache
def _load_family(name: str, files: str) -> Callable[[str, Any], Any]:
    """Return the maker of the controllers of a package's family."""
    extension = check_files(name, files)
    made = extension.load()
    if not callable(made):
        raise extension.error("a callable that takes a task and its model", repr(made))
    return made


def try_family(task: str, name: str) -> None:
    """Let two persons of a package's family act once, to find out whether they can.

    Raises:
        ValueError: They cannot, and why.
    """
    extension = installed_family(name)
    expected = f"a controller of {task} as `assistax_envs.persons.controller.Controller`"
    width, actions = SEAT_SIZES[task]
    try:
        player = PersonPlayer(task, name, files_sha256(extension.files()))
        rows, obs = jnp.asarray(marked(persons(task)[:2])), jnp.zeros((2, width), jnp.float32)
        begun = player.initial_carry((2,))
        carry, action = player.act({"row": rows}, begun, obs, jnp.ones(2, bool))
        word = player.word(carry)
    except Exception as error:
        found = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        raise extension.error(expected, found[:300]) from error
    if (np.shape(action), np.shape(word)) != ((2, actions), (2,)):
        found = f"actions of shape {np.shape(action)} and words of shape {np.shape(word)}"
        raise extension.error(f"{expected}: actions [N, {actions}] and words [N]", found)


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
    """Return the humans [N] of persons with rows [N, 30] or [N, 31]: bodies and preferences.

    Strength and tremor are the person's own, and not taken twice.
    """
    place, n = index(task), len(rows)
    column = {name: jnp.asarray(rows[:, where]) for name, where in place.items()}
    one = jnp.ones(n, jnp.float32)
    names = (field.name for field in dataclasses.fields(Preferences))
    liked = {name: column.get(f"liked_{name}", one) for name in names}
    preference = Preferences(**liked | {"tolerance": column["tolerance"]})
    return EnvParams(
        strength=one,
        elbow_range=column["range"],
        tremor=jnp.zeros(n, jnp.float32),
        preference_code=jnp.zeros(n, jnp.int32),
        preference=preference,
    )
