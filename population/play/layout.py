"""Layout of a block's simulations on the environment's flat axis."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Shaped


@dataclasses.dataclass(frozen=True)
class Layout:
    """Size of a block, and the rows of the flat axis of each robot and human.

    E = 2 robots, P = 2 humans and K = 3 episodes are N = 12 simulations, numbered as the
    environment has them:

                   human 0    human 1
        robot 0    0  1  2    3  4  5
        robot 1    6  7  8    9 10 11

    The robots' network sees [E, P * K, O]: robot 0 has rows 0 1 2 3 4 5, robot 1 has 6 to 11.
    The humans' network sees [P, E * K, O]: human 0 has rows 0 1 2 6 7 8, human 1 the others.
    If robot i plays human i alone, E is 1 and both networks see [P, K, O].
    """

    egos: tuple[int, ...]  # size of each stack of robots; empty for a robot from outside
    partners: tuple[int, ...]  # size of each stack of humans
    episodes: int
    paired: bool = False

    @property
    def block(self) -> tuple[int, int, int]:
        """Shape [E, P, K] of the block."""
        e = 1 if self.paired or not self.egos else sum(self.egos)
        return e, sum(self.partners), self.episodes

    def to_flat(self, values: jax.Array) -> jax.Array:
        """Return a value for each simulation [N], from values that broadcast to [E, P, K]."""
        return jnp.broadcast_to(values, self.block).reshape(-1)

    def for_robots(self, starts: jax.Array) -> jax.Array:
        """Return rows [N, ...] in which each robot has the rows [P * K, ...] of all episodes."""
        e, p, k = self.block
        return jnp.broadcast_to(starts, (e, *starts.shape)).reshape(e * p * k, *starts.shape[1:])

    def to_robots(self, flat: Float[Array, "N O"]) -> Float[Array, "G R O"]:
        """Return rows grouped by robot."""
        e, p, k = self.block
        return flat.reshape(*((p, k) if self.paired else (e, p * k)), -1)

    def from_robots(self, rows: Float[Array, "G R A"]) -> Float[Array, "N A"]:
        """Return the flat rows of rows grouped by robot, the inverse of `to_robots`."""
        return rows.reshape(rows.shape[0] * rows.shape[1], -1)

    def to_humans(self, flat: Float[Array, "N O"]) -> Float[Array, "G R O"]:
        """Return rows grouped by human."""
        e, p, k = self.block
        return flat.reshape(e, p, k, -1).swapaxes(0, 1).reshape(p, e * k, -1)

    def from_humans(self, rows: Shaped[Array, "G R A"]) -> Shaped[Array, "N A"]:
        """Return the flat rows of rows grouped by human, the inverse of `to_humans`."""
        e, p, k = self.block
        return rows.reshape(p, e, k, -1).swapaxes(0, 1).reshape(e * p * k, -1)
