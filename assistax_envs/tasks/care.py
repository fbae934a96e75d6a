"""Care: how well a touch is liked, discomfort and violations, one law for all gentle tasks.

A wish is a quantity that a person likes to have near a value of its own: a force, a speed, a
distance, a depth. What is done of a wish is smoothed over 0.3 s and judged by its ratio to the
liked value. Shapes: N simulations, W wishes of the task, in the order of its preferences. Forces
in N, lengths in m, speeds in m/s.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.preferences import PREFERRED, WIDTH, middles
from assistax_envs.tasks.base import Measures
from assistax_envs.tasks.gentle_base import FELT, STEP, Preferences, TouchReadings

WITHIN = 1.5  # factor from the liked value, up to which a touch counts as liked
WHATEVER = 0.05  # share of a pay that no wish changes
SMOOTHED = 0.3  # s, over which a touch is judged
MOST = 2.0  # largest discomfort
UNEASY = 0.2  # share of touched steps that may have discomfort in a caring episode
SUSTAINED = 25  # steps above the quasi-static limits, all added up, that are a violation: 0.5 s
NONE, IMPACT, PRESSED = range(3)  # kinds of violation: one too hard, or too long above the limits
# Multiples of the liked value beyond which a wish causes discomfort: at least, at most. Force is
# judged by the person's tolerance instead.
COMFORTABLE: Mapping[str, tuple[float, float]] = {
    "speed": (0.0, 2.0),
    "distance": (0.5, np.inf),
    "wait": (0.5, np.inf),
    "depth": (0.0, 1.6),
}
COSTS = {"discomfort": 0.3, "unsteady": 0.1}  # weights of `costs`


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Care:
    """Touches of a person so far, and the discomfort and violations in them."""

    width: jax.Array  # [N] of liking; training may begin with a larger one
    done: jax.Array  # [N, W] of each wish, smoothed over the time that it was judged
    judged: jax.Array  # [N, W] bool: the wish is judged at this step
    gap: jax.Array  # [N, W] s since it was judged
    spread: jax.Array  # [N] squared logarithm of the first wish's sample over `done`, at most 1
    force: jax.Array  # [N] N, of all touches, smoothed
    felt: jax.Array  # [N] bool: something was felt at this step
    discomfort: jax.Array  # [N] 0 to `MOST`
    touched: jax.Array  # [N] int32, steps in which anything was felt
    uneasy: jax.Array  # [N] int32, those of them with discomfort
    pressed: jax.Array  # [N] int32, steps above the quasi-static limits
    violation: jax.Array  # [N] int32: `NONE`, `IMPACT` or `PRESSED`, the first that happened

    @property
    def violated(self) -> jax.Array:
        """Whether some contact was a violation [N]."""
        return self.violation != NONE

    @property
    def kept(self) -> jax.Array:
        """Whether there was no violation, and discomfort in few of the touched steps [N]."""
        return ~self.violated & (self.uneasy <= UNEASY * self.touched)


def untouched(task: str, params: Any) -> Care:
    """Return the care of one simulation before its first step; `params` is its `EnvParams`."""
    wishes = len(PREFERRED[task])
    zero, none = jnp.zeros((), jnp.float32), jnp.zeros((), jnp.int32)
    width = WIDTH if params.width is None else params.width
    return Care(
        width=jnp.asarray(width, jnp.float32),
        done=jnp.zeros(wishes, jnp.float32),
        judged=jnp.zeros(wishes, bool),
        gap=jnp.full(wishes, SMOOTHED, jnp.float32),
        spread=zero,
        force=zero,
        felt=jnp.zeros((), bool),
        discomfort=zero,
        touched=none,
        uneasy=none,
        pressed=none,
        violation=none,
    )


def after(
    care: Care,
    task: str,
    preference: Preferences,
    r: TouchReadings,
    sample: tuple[jax.Array, ...],
    judged: tuple[jax.Array, ...],
    unit: jax.Array | float,
) -> Care:
    """Return the care after a step.

    Args:
        care: That before it.
        task: Its name.
        preference: What the humans like and bear.
        r: Readings of the step.
        sample: What is done of each wish at this step, W times [N].
        judged: Whether it is judged, W times [N] bool.
        unit: N, of the force that hurts, which is this times the person's tolerance.
    """
    now, active = jnp.stack(sample, axis=-1), jnp.stack(judged, axis=-1)
    keep = STEP / SMOOTHED
    # A tool that bounces touches anew many times: that is one touch.
    smooth = jnp.where(care.gap < SMOOTHED, care.done + keep * (now - care.done), now)
    done = jnp.where(active, smooth, care.done)
    off = jnp.log(jnp.maximum(now[:, 0], 1e-3) / jnp.maximum(done[:, 0], 1e-3))
    force = care.force + keep * (r.force - care.force)
    force = jnp.where(r.force > FELT, force, 0.0)
    ratio = done / preference.of(task)
    discomfort = _discomfort(task, ratio, active, force / (preference.tolerance * unit))
    felt = active.any(axis=1) | (r.force > FELT)
    pressed = care.pressed + r.hurt
    kind = jnp.where(r.struck, IMPACT, jnp.where(pressed > SUSTAINED, PRESSED, NONE))
    return Care(
        width=care.width,
        done=done,
        judged=active,
        gap=jnp.where(active, 0.0, jnp.minimum(care.gap + STEP, SMOOTHED)),
        spread=jnp.where(active[:, 0], jnp.minimum(off**2, 1.0), 0.0),
        force=force,
        felt=felt,
        discomfort=discomfort,
        touched=care.touched + felt,
        uneasy=care.uneasy + (felt & (discomfort > 0.0)),
        pressed=pressed,
        violation=jnp.where(care.violation == NONE, kind, care.violation).astype(jnp.int32),
    )


def felt_by(care: Care, task: str) -> jax.Array:
    """Return the touch as a human feels it [N, 2W]: each wish's `done` over its middle, `judged`.

    A human feels this and no robot does: it says where the environment judges a wish.
    """
    share = care.done / jnp.array([middles(task)])
    return jnp.concatenate([share, care.judged.astype(jnp.float32)], axis=-1)


def liked(done: jax.Array, best: jax.Array, width: jax.Array) -> jax.Array:
    """Return exp(-ln(done / best)^2 / (2 width^2)): 1 at the best, 0.5 at 1.5 times it."""
    return jnp.exp(-0.5 * (jnp.log(jnp.maximum(done, 1e-3) / best) / width) ** 2)


def within(done: jax.Array, best: jax.Array) -> jax.Array:
    """Return whether a done value lies within a factor `WITHIN` of the best."""
    return jnp.abs(jnp.log(jnp.maximum(done, 1e-3) / best)) <= np.log(WITHIN)


def paid(well: jax.Array) -> jax.Array:
    """Return the share of a pay for a liking from 0 to 1; at 0 it is `WHATEVER`."""
    return WHATEVER + (1.0 - WHATEVER) * well


def costs(care: Care) -> dict[str, jax.Array]:
    """Return the costs of a step [N], unweighted: discomfort, and a touch that is unsteady."""
    return {"discomfort": -care.discomfort, "unsteady": -care.spread}


def measures(
    care: Care,
    r: TouchReadings,
    distance: jax.Array,
    success: jax.Array,
    liked: jax.Array,
) -> Measures:
    """Return the measures of a step of a gentle task.

    Args:
        care: That after the step.
        r: Readings of the step.
        distance: [N] m, from the tool to its target.
        success: [N] bool, whether the goal holds, if there was care.
        liked: [N, W] values of the wishes.
    """
    return Measures(
        force=r.force,
        distance=distance,
        success=success & care.kept,
        contact=r.peak,
        violated=care.violated,
        violation=care.violation,
        together=r.together,
        speed=jnp.linalg.norm(r.tool_velocity, axis=-1),
        face=r.face,
        done=care.done,
        liked=liked,
        judged=care.judged,
        felt=care.felt,
        discomfort=care.discomfort,
    )


def _discomfort(task: str, ratio: jax.Array, judged: jax.Array, force: jax.Array) -> jax.Array:
    """Return the discomfort [N] of wishes by done over liked, and of forces that hurt."""
    excess = force - 1.0
    for place, name in enumerate(PREFERRED[task]):
        low, high = COMFORTABLE.get(name, (0.0, np.inf))
        share = jnp.maximum(ratio[:, place], 1e-3)
        beyond = jnp.maximum(low / share, share / high) - 1.0
        excess = jnp.maximum(excess, jnp.where(judged[:, place], beyond, -1.0))
    return jnp.clip(excess, 0.0, MOST)
