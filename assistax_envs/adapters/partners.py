"""Partners in the human's seat of a batch of simulations, drawn anew for each episode."""

from collections.abc import Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.disability import Disability
from assistax_envs.humans import EnvParams, disability_params
from assistax_envs.own_settings import own_settings
from assistax_envs.persons import PersonPlayer, person_params, persons
from assistax_envs.persons.rows import COUNT, ROWS, marked, side
from assistax_envs.persons.rows import numbers as of_side


class Partners(Protocol):
    """Partners of N simulations, one each and a new one in each episode; pure functions.

    `begin` and `act` receive `params`, so that these arrays are no constants of a compiled program.
    """

    @property
    def params(self) -> Any: ...

    def begin(self, params: Any, key: jax.Array, before: Any, n: int) -> tuple[Any, EnvParams]:
        """Return the partners of an episode, with their bodies and preferences.

        Args:
            params: The partners' arrays.
            key: Key of the episode.
            before: Partners of the episode before, as `act` returned them; None at first.
            n: Simulations.

        Returns:
            The seated partners, any pytree; and their bodies and preferences [N].
        """
        ...

    def act(
        self, params: Any, seated: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        """Return the seated partners, with new memories, and their actions [N, 3] for obs [N, O].

        In tasks at the mouth actions are [N, 5].
        """
        ...

    def names(self, seated: Any, n: int) -> list[str]:
        """Return the name of each simulation's partner."""
        ...

    # Partners that speak also have `word(seated, n)`, which returns the words [N] int32 that they
    # said with their last actions, codes of `preferences.WORDS`; or None.


class Idle:
    """Idle humans; if there are several disability settings, each episode draws one."""

    params = ()

    def __init__(self, disability: str | Disability | Sequence[str | Disability] = "d1") -> None:
        settings = [disability] if isinstance(disability, str | Disability) else disability
        if not settings:
            raise ValueError("no disability setting is named; give at least one, such as 'd1'")
        self._bodies = disability_params(settings)

    def begin(self, params: Any, key: jax.Array, before: Any, n: int) -> tuple[Any, EnvParams]:
        del params, before
        drawn = jax.random.randint(key, (n,), 0, self._bodies.strength.shape[0])
        return (), jax.tree.map(lambda leaf: leaf[drawn], self._bodies)

    def act(
        self, params: Any, seated: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        del params, first
        # One zero for all torques of a human: tasks have three of them or five.
        return seated, jnp.zeros((obs.shape[0], 1), jnp.float32)

    def names(self, seated: Any, n: int) -> list[str]:
        del seated
        return ["nobody"] * n


class Persons:
    """Persons (docs/persons.md); each simulation draws a new one for each episode."""

    @own_settings()
    def __init__(self, task: str, numbers: Sequence[int] | None = None) -> None:
        """Choose the persons that the simulations meet.

        Args:
            task: Task of the persons.
            numbers: Numbers of persons; default all of the training side, of both families.

        Raises:
            ValueError: There is no such task, or a number is unknown or of the test side.
        """
        if numbers is None:
            numbers = of_side("training").tolist()
        for number in numbers:
            if not 0 <= number < COUNT or side(number) == "test":
                raise ValueError(
                    f"person {number} cannot be trained with; allowed are persons of the training "
                    "and validation sides, 0 to 7999 and 10000 to 17999, as the others are for "
                    "testing"
                )
        if not len(numbers):
            raise ValueError("no person is named; give at least one number")
        rows, families = persons(task)[np.asarray(numbers) % ROWS], np.asarray(numbers) // ROWS
        self._task, self._count, self._player = task, len(rows), PersonPlayer(task)
        # Numbers [P], rows [P, 31], and the persons' `EnvParams` [P].
        row = jnp.asarray(marked(rows, families))
        self.params = jnp.asarray(numbers), row, person_params(task, rows)

    def __len__(self) -> int:
        return self._count

    def begin(self, params: Any, key: jax.Array, before: Any, n: int) -> tuple[Any, EnvParams]:
        """Return N drawn persons, all different if N does not exceed their number."""
        del before
        drawn = jax.random.choice(key, len(self), (n,), replace=n > len(self))
        number, row, humans = jax.tree.map(lambda leaf: leaf[drawn], params)
        return (number, row, self._player.initial_carry((n,))), humans

    def act(
        self, params: Any, seated: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        del params
        number, row, mind = seated
        mind, action = self._player.act({"row": row}, mind, obs, first)
        return (number, row, mind), action

    def word(self, seated: Any, n: int) -> jax.Array:
        """Return the words [N] int32 that they said with their last actions."""
        del n
        return self._player.word(seated[-1])

    def names(self, seated: Any, n: int) -> list[str]:
        del n
        return [f"{self._task}/person-{number:05d}" for number in seated[0].tolist()]
