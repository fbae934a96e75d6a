"""Who sits in the human's seat of a batch of simulations, and for how long: one episode."""

from collections.abc import Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.disability import Disability
from assistax_envs.humans import EnvParams, disability_params
from assistax_envs.persons import PersonPlayer, person_params, persons
from assistax_envs.persons.rows import COUNT, side


class Partners(Protocol):
    """A partner for each of N simulations, another one in each episode; pure functions.

    `params` are arrays that `begin` and `act` are handed back, so that they are no constants of a
    compiled program.
    """

    @property
    def params(self) -> Any: ...

    def begin(self, params: Any, key: jax.Array, before: Any, n: int) -> tuple[Any, EnvParams]:
        """Seat the partners of an episode.

        Args:
            params: The partners' arrays.
            key: Of the episode.
            before: Who sat there in the episode before, as `act` returned them; None at first.
            n: Simulations.

        Returns:
            Who sits there now, any pytree; and their bodies and preferences [N].
        """
        ...

    def act(
        self, params: Any, seated: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        """Return who sits there, with what they remember, and the actions [N, 3] for obs [N, O]."""
        ...


class Idle:
    """Humans who do nothing: of several disability settings, each episode draws one."""

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
        return seated, jnp.zeros((obs.shape[0], 3), jnp.float32)


class Persons:
    """Persons of a gentle task (docs/persons.md): each simulation draws a new one each episode."""

    def __init__(self, task: str, numbers: Sequence[int] | None = None) -> None:
        """Choose whom the simulations meet.

        Args:
            task: A task that has persons.
            numbers: Of persons; default all of the training side, 7,200.

        Raises:
            ValueError: The task has no persons, or a number is unknown or of the test side.
        """
        rows = persons(task)
        if numbers is None:
            numbers = [number for number in range(COUNT) if side(number) == "training"]
        for number in numbers:
            if not 0 <= number < COUNT or side(number) == "test":
                raise ValueError(
                    f"person {number} cannot be trained with; allowed are those of the training "
                    "and validation sides, 0 to 7999, as the others are for testing"
                )
        if not len(numbers):
            raise ValueError("no person is named; give at least one number")
        self.task, self._player = task, PersonPlayer(task)
        self._rows = jnp.asarray(rows[np.asarray(numbers)])

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def params(self) -> jax.Array:
        """The rows [P, 25] of the persons."""
        return self._rows

    def begin(
        self, params: jax.Array, key: jax.Array, before: Any, n: int
    ) -> tuple[Any, EnvParams]:
        """Draw N persons: all different where there are as many."""
        del before
        rows: Any = jax.random.choice(key, params, (n,), replace=n > len(self))
        return (rows, self._player.initial_carry((n,))), person_params(self.task, rows)

    def act(
        self, params: Any, seated: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        del params
        rows, mind = seated
        mind, action = self._player.act({"row": rows}, mind, obs, first)
        return (rows, mind), action
