"""What an episode of a gentle task comes to for the person, added up step by step.

It is about what was done of each wish beside what is liked, discomfort, and violations. Wishes are
measured late in an episode, once a robot had the time to listen.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from assistax_envs.tasks.care import NONE, within
from population.environment import EnvState

LATE = 500  # steps: what is done of a wish counts after second 10


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Wish:
    """Sums of one wish of each episode so far; leaves [N], and [E, P, K] once a block is done."""

    liked: Float[Array, "*N"]  # the value that the person likes, in the wish's unit
    log_done: Float[Array, "*N"]  # logarithm of what was done, summed over late judged steps
    judged: Int[Array, "*N"]  # late steps in which the wish was judged
    within: Int[Array, "*N"]  # those of them within a factor `care.WITHIN` of the liked value


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Caring:
    """Sums of what the person felt; leaves [N], and [E, P, K] once a block is done."""

    wishes: tuple[Wish, ...]  # in the order of the task's preferences
    felt: Int[Array, "*N"]  # steps in which the person felt something
    uneasy: Int[Array, "*N"]  # those of them with discomfort
    violation: Int[Array, "*N"]  # its kind, such as `care.IMPACT`


def begin_caring(state: EnvState) -> Caring | None:
    """Return the sums at the start of episodes; None if the task measures no wishes."""
    if getattr(state.measures, "done", None) is None:
        return None
    zero = jnp.zeros(state.reward.shape)
    count = jnp.zeros(zero.shape, jnp.int32)
    liked = jnp.moveaxis(state.measures.liked, -1, 0)
    wishes = tuple(Wish(value, zero, count, count) for value in liked)
    return Caring(wishes, count, count, jnp.full(zero.shape, NONE, jnp.int32))


def add_caring(
    caring: Caring | None, state: EnvState, earning: Bool[Array, "*N"], time: jax.Array
) -> Caring | None:
    """Return the sums after a step.

    Args:
        caring: Those before it.
        state: The state after the step.
        earning: Episodes that have not ended and whose physics is finite.
        time: Number of the step in the episode [], from 0.
    """
    if caring is None:
        return None
    measures = state.measures
    late = earning & (time >= LATE)
    felt = earning & measures.felt
    return Caring(
        wishes=tuple(
            _with_step(wish, measures.done[:, place], late & measures.judged[:, place])
            for place, wish in enumerate(caring.wishes)
        ),
        felt=caring.felt + felt,
        uneasy=caring.uneasy + (felt & (measures.discomfort > 0.0)),
        violation=jnp.where(earning, measures.violation, caring.violation).astype(jnp.int32),
    )


def caring_columns(caring: Caring | None, wishes: Sequence[str]) -> dict[str, Any]:
    """Return the columns of finished episodes from NumPy sums [N], by name.

    `done_WISH` is the geometric mean of what was done of a wish, and `within_WISH` the share of
    the steps near the liked value; both are NaN where the wish was never judged late. Without any
    touch `discomfort_share` is 0. `violation` is the number of its kind in `care`.

    Args:
        caring: The sums; None gives no columns.
        wishes: Names of the wishes, in their order.
    """
    if caring is None:
        return {}
    columns: dict[str, Any] = {}
    for name, wish in zip(wishes, caring.wishes, strict=True):
        judged = np.where(wish.judged > 0, wish.judged, np.nan)
        columns |= {
            f"liked_{name}": wish.liked,
            f"done_{name}": np.exp(wish.log_done / judged),
            f"within_{name}": wish.within / judged,
        }
    return columns | {
        "discomfort_share": caring.uneasy / np.maximum(caring.felt, 1),
        "violation": caring.violation,
    }


def _with_step(wish: Wish, done: Float[Array, "*N"], judged: Bool[Array, "*N"]) -> Wish:
    log_done = jnp.log(jnp.maximum(done, 1e-3))
    return Wish(
        liked=wish.liked,
        log_done=wish.log_done + jnp.where(judged, log_done, 0.0),
        judged=wish.judged + judged,
        within=wish.within + (judged & within(done, wish.liked)),
    )
