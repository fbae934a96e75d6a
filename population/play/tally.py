"""Tally of an episode's rewards and measures, added up step by step."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from population.environment import EnvState
from population.play.caring import Caring, add_caring, begin_caring

GAMMA = 0.99  # of the discounted return


class Column:
    """A quantity of an episode that a package adds, computed from its steps.

    A value is an array [N], or a tree of such arrays, one entry an episode. `begin` and `add` are
    compiled with the rollout. What `add` returns for an episode that has ended, or whose physics
    became non-finite, is not used.
    """

    def begin(self, state: EnvState) -> Any:
        """Return the value at the start of episodes; zeros unless a subclass says otherwise."""
        return jnp.zeros(state.reward.shape)

    def add(self, value: Any, before: EnvState, state: EnvState, time: jax.Array) -> Any:
        """Return the value after a step.

        Args:
            value: The value before the step.
            before: The environment's state before the step.
            state: The state after the step.
            time: Number of the step in the episode [], from 0.
        """
        raise NotImplementedError

    def end(self, value: Any, steps: Int[np.ndarray, "*N"]) -> Any:
        """Return the column's numbers [N] of finished episodes, from NumPy values.

        Args:
            value: The value after the last step.
            steps: Steps that each episode had.
        """
        return value


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Tally:
    """Sums of each episode so far; leaves [N], and [E, P, K] once a block is done."""

    running: Bool[Array, "*N"]  # the episode has not ended
    steps: Int[Array, "*N"]
    returns: Float[Array, "*N"]  # sum of rewards
    discounted: Float[Array, "*N"]  # sum of GAMMA**t * reward
    terms: dict[str, jax.Array]  # sum of each weighted reward term
    force_sum: Float[Array, "*N"]  # N, summed over steps
    force_peak: Float[Array, "*N"]  # N
    first_contact: Int[Array, "*N"]  # the first step with a force; 0 before it
    distance_sum: Float[Array, "*N"]  # m, summed over steps
    travel: dict[str, jax.Array]  # rad by role: angles that all joints went through together
    # At any step. Of a gentle task at the last step: care must have lasted to the end.
    success: Bool[Array, "*N"]
    nonfinite: Bool[Array, "*N"]  # the physics became non-finite
    contact_peak: Any = None  # [N] N, the largest single contact; None if it is not measured
    violated: Any = None  # [N] bool, a contact was above the hard limit; None likewise
    # Measures of touch by name, see `TOUCH`, each [N]; empty if touch is not measured.
    touch: dict[str, jax.Array] = dataclasses.field(default_factory=dict)
    caring: Caring | None = None  # what the person felt; None if it is not measured
    # Values of the columns that installed packages add, by name.
    columns: dict[str, Any] = dataclasses.field(default_factory=dict)


# Measures of touch. `end_steps`: steps touched with a joint of the arm at its limit. `touch_speed`:
# m/s of the tool in the step before the first touch, 0 without one. `face_least`: m, least distance
# of the tool from the face. `together_peak`: N, the largest sum of simultaneous contacts.
# `sustained_force`: N, the largest mean over SECOND of all contacts.
TOUCH = ("end_steps", "touch_speed", "face_least", "together_peak", "sustained_force")
SECOND = 50  # steps


def begin(
    state: EnvState, joints: dict[str, jax.Array], columns: Mapping[str, Column] | None = None
) -> Tally:
    """Return the tally of episodes at their start, with joint positions by role."""
    zero = jnp.zeros(state.reward.shape)
    false, count = jnp.zeros(zero.shape, bool), jnp.zeros(zero.shape, jnp.int32)
    return Tally(
        running=~false,
        steps=count,
        returns=zero,
        discounted=zero,
        terms=dict.fromkeys(state.terms, zero),
        force_sum=zero,
        force_peak=zero,
        first_contact=count,
        distance_sum=zero,
        travel=dict.fromkeys(joints, zero),
        success=false,
        nonfinite=false,
        contact_peak=None if state.measures.contact is None else zero,
        violated=None if state.measures.violated is None else false,
        touch=_untouched(state) if _measured(state) else {},
        caring=begin_caring(state),
        columns={name: column.begin(state) for name, column in (columns or {}).items()},
    )


def begin_window(state: EnvState) -> Float[Array, "S N"] | None:
    """Return the forces of the last second [S, N], all 0; None if touch is not measured."""
    return jnp.zeros((SECOND, *state.reward.shape)) if _measured(state) else None


def accumulate(
    tally: Tally,
    before: EnvState,
    state: EnvState,
    travel: dict[str, jax.Array],
    window: Float[Array, "S N"] | None,
    time: jax.Array,
    columns: Mapping[str, Column] | None = None,
) -> Tally:
    """Return the tally with the step from `before` to `state`, number `time`, of running episodes.

    `window` holds the forces of the last second, including this step's.
    """
    running = tally.running
    earning = running & ~state.nonfinite

    def gained(value: Float[Array, "*N"]) -> Float[Array, "*N"]:
        return jnp.where(earning, value, 0.0)

    measures = state.measures
    reward, force = gained(state.reward), gained(measures.force)
    touches = {}
    if tally.contact_peak is not None:
        peak = jnp.maximum(tally.contact_peak, gained(measures.contact))
        touches = {"contact_peak": peak, "violated": tally.violated | (earning & measures.violated)}
    return Tally(
        running=running & ~(state.terminated | state.truncated),
        steps=tally.steps + running,
        returns=tally.returns + reward,
        discounted=tally.discounted + GAMMA ** time.astype(jnp.float32) * reward,
        terms={name: tally.terms[name] + gained(value) for name, value in state.terms.items()},
        force_sum=tally.force_sum + force,
        force_peak=jnp.maximum(tally.force_peak, force),
        first_contact=jnp.where(
            (tally.first_contact == 0) & (force > 0), time + 1, tally.first_contact
        ),
        distance_sum=tally.distance_sum + gained(measures.distance),
        travel={role: tally.travel[role] + gained(value) for role, value in travel.items()},
        success=_succeeded(tally, measures.success, earning),
        nonfinite=tally.nonfinite | (running & state.nonfinite),
        touch=_touched(tally, before, state, earning, window),
        caring=add_caring(tally.caring, state, earning, time),
        columns={
            name: jax.tree.map(
                lambda old, new: jnp.where(earning, new, old).astype(old.dtype),
                tally.columns[name],
                column.add(tally.columns[name], before, state, time),
            )
            for name, column in (columns or {}).items()
        },
        **touches,
    )


def _succeeded(tally: Tally, success: jax.Array, earning: jax.Array) -> jax.Array:
    """Return the success [N] after a step: care that ends takes it away again."""
    if tally.caring is None:
        return tally.success | (earning & success)
    return jnp.where(earning, success, tally.success)


def _measured(state: EnvState) -> bool:
    """Return whether the environment measures touch."""
    return getattr(state.measures, "together", None) is not None


def _untouched(state: EnvState) -> dict[str, jax.Array]:
    """Return the measures of touch at an episode's start."""
    zero = jnp.zeros(state.reward.shape)
    count = jnp.zeros(zero.shape, jnp.int32)
    return {**dict.fromkeys(TOUCH, zero), "end_steps": count, "face_least": state.measures.face}


def _touched(
    tally: Tally,
    before: EnvState,
    state: EnvState,
    earning: jax.Array,
    window: Float[Array, "S N"] | None,
) -> dict[str, jax.Array]:
    """Return the measures of touch after a step; empty if there is no window."""
    if window is None:
        return {}
    touch, measures = tally.touch, state.measures
    starts = earning & (tally.first_contact == 0) & (measures.force > 0)
    face = jnp.where(earning, measures.face, touch["face_least"])
    together = jnp.where(earning, measures.together, 0.0)
    mean = jnp.where(earning, window.mean(axis=0), 0.0)
    return {
        "end_steps": touch["end_steps"] + (earning & measures.at_end),
        "touch_speed": jnp.where(starts, before.measures.speed, touch["touch_speed"]),
        "face_least": jnp.minimum(touch["face_least"], face),
        "together_peak": jnp.maximum(touch["together_peak"], together),
        "sustained_force": jnp.maximum(touch["sustained_force"], mean),
    }
