"""One frozen policy in one seat of one simulation: NumPy observations in, NumPy actions out."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float32, Int32, Shaped

from assistax_base.errors import UnknownIdError
from assistax_envs.disability import Disability
from assistax_envs.own_settings import own_settings
from population.networks.seat import Seat
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry
from zoo.schema import PolicyEntry


class Partner:
    """A frozen policy in its seat: NumPy observations in, its most likely actions out.

    Fits the human's seat of the Gymnasium adapter, which resets it and takes its setting from here.

    Attributes:
        id: Such as "scratch/ippo-d1-s0-v1/human", or the path of its file.
        spec: Its network: role, sizes, layers.
        setting: A human's disability setting, as values. None if its file names no setting. Of a
            person it has the range alone: its program applies its strength and tremor itself.
        card: The registry's entry: training, self-play, hash. None if it is from a file.

    Examples:
        >>> from assistax_zoo import open_zoo
        >>> partner = open_zoo().partner("scratch/ippo-d1-s0-v1")
        >>> partner.act(np.zeros((2, partner.spec.observation_size), np.float32)).shape
        (2, 3)
    """

    @own_settings()
    def __init__(
        self,
        id: str,
        spec: Seat,
        params: dict[str, Any],
        setting: Disability | None = None,
        card: PolicyEntry | None = None,
    ) -> None:
        self.id, self.spec, self.setting, self.card = id, spec, setting, card
        self._params = jax.device_put(params)
        self._carry: Any = None
        self._rows: tuple[int, ...] = ()  # of the episode's observations
        self._word = np.zeros((), np.int32)

    @property
    def params(self) -> dict[str, Any]:
        """Its parameters, as NumPy arrays by layer; of a person its numbers, as "row" [31]."""
        return jax.device_get(self._params)

    @property
    def env_version(self) -> int | None:
        """The environment version in which it was trained; None if it is from a file."""
        return None if self.card is None else self.card.training.env_version

    @property
    @own_settings()
    def humans(self) -> Any:
        """Its own `EnvParams` [1]; None if a setting and a preference are chosen for it."""
        if not self.spec.own_preferences:
            return None
        stacked = jax.tree.map(lambda leaf: leaf[None], self._params)
        return self.spec.humans(stacked, [self.setting or "d1"], None)

    def reset(self, rows: int | None = None) -> None:
        """Clear the memory before an episode. `rows`, which evaluators pass, is not used."""
        del rows
        self._carry = None

    @own_settings()
    def act(self, obs: Shaped[np.ndarray, "*batch O"]) -> Float32[np.ndarray, "*batch A"]:
        """Return the most likely actions.

        Args:
            obs: Observations [..., O]; the leading axes stay the same within an episode.

        Returns:
            Actions [..., A] in [-1, 1], float32.

        Raises:
            ValueError: O is not `spec.observation_size`, or the leading axes change within the
                episode of one that remembers.
        """
        obs = np.asarray(obs, np.float32)
        if obs.shape[-1:] != (self.spec.observation_size,):
            raise ValueError(
                f"{self.id} got observations {obs.shape}; expected [..., "
                f"{self.spec.observation_size}]"
            )
        # Two rows at least, as in the evaluator: a product with one row is rounded differently on
        # the CPU.
        batch = np.broadcast_to(obs, (2, *obs.shape)) if obs.ndim == 1 else obs
        first = np.full(batch.shape[:-1], self._carry is None)
        if self._carry is None:
            self._carry, self._rows = self.spec.player().initial_carry(first.shape), obs.shape[:-1]
        if obs.shape[:-1] != self._rows and jax.tree.leaves(self._carry):
            raise ValueError(
                f"{self.id} got observations {obs.shape} in an episode that began with "
                f"{(*self._rows, obs.shape[-1])}; call reset() before another number of them"
            )
        self._carry, action, word = _acting(self.spec)(self._params, self._carry, batch, first)
        self._word = np.array(word[0] if obs.ndim == 1 else word)
        return np.array(action[0] if obs.ndim == 1 else action)

    __call__ = act

    def word(self) -> Int32[np.ndarray, "*batch"]:
        """Return the words said with the last actions, as codes of `preferences.WORDS`.

        0 is silence: networks never speak.
        """
        return self._word

    def __repr__(self) -> str:
        return f"Partner({self.id!r}, {self.spec.observation_size} -> {self.spec.action_size})"


def zoo_partner(registry: Registry, policy: str, role: str = "human") -> Partner:
    """Return the partner with an id, or of a team's id and a role, with its hash checked.

    Raises:
        ZooError: There is not exactly one such policy, or its bytes have another hash.
    """
    entries = registry.select(policy, role=role)
    if len(entries) != 1:
        raise UnknownIdError(
            f"{policy!r} is not one policy",
            expected="the id of one policy",
            found=f"{len(entries)} that match, such as {entries[0].id}",
            done="nothing was loaded",
            next_step="name one; `assistax-zoo list` prints every id",
        )
    [group], [entry] = load_stacks(registry, entries), entries
    return Partner(entry.id, group.spec, group.row(0), entry.setting, entry)


@functools.cache
def _acting(spec: Seat) -> Callable[..., tuple[Any, jax.Array, jax.Array]]:
    policy: Any = spec.player()

    def acting(params: Any, carry: Any, obs: Any, first: Any) -> tuple[Any, jax.Array, jax.Array]:
        carry, action = policy.act(params, carry, jnp.asarray(obs), first)
        silence = jnp.zeros(first.shape, jnp.int32)
        return carry, action, policy.word(carry) if hasattr(policy, "word") else silence

    return jax.jit(acting)
