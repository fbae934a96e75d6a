"""Reactions of a person: discomfort, stiffening, withdrawal, leaning in. Two laws, one a family.

A robot can read them with every person. Shapes: N simulations; shifts [N, J] rad are of the
intended posture.
"""

import dataclasses

import jax
import jax.numpy as jnp

from assistax_envs.tasks.gentle_base import FELT, LIGHT, STEP

MOST = 2.0  # largest excess of a touch that counts
FAST = 2.0  # multiple of a liked speed, above which it is too fast
DOSE = 0.1  # s times excess of force, above which the second law guards
CALM = 1.0  # s, in which the second law forgets
FLINCH = 0.2  # s


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Felt:
    """Touch that a person feels, after its delay."""

    force: jax.Array  # [N] N, of all touches
    hurts: jax.Array  # [N] N, from where on
    liked: jax.Array  # [N] N, preferred; 0 if no pressure is missed
    asks: jax.Array  # [N] N, a push that asks for help
    speed: jax.Array  # [N] sliding speed, as a share of the preferred one; 1 if it does not matter
    near: jax.Array  # [N] distance of a robot that waits, likewise
    away: jax.Array  # [N, J] unit joint direction that moves the skin away from the tool


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Reaction:
    """State of a person's reaction: the carry of either law."""

    discomfort: jax.Array  # [N]
    lightness: jax.Array  # [N] 0 to 1: how much it misses pressure
    dose: jax.Array  # [N] s, of the second law
    guarding: jax.Array  # [N] s since it began to guard, 0 if it does not; of the second law
    shift: jax.Array  # [N, J] rad


def calm(n: int, joints: int = 3) -> Reaction:
    """Return the reaction of N persons that have not been touched yet."""
    zero = jnp.zeros(n, jnp.float32)
    return Reaction(zero, zero, zero, zero, jnp.zeros((n, joints), jnp.float32))


def proportional(now: Reaction, felt: Felt, numbers: dict[str, jax.Array]) -> Reaction:
    """Return the next reaction by the first law: c' = (max(0, F / F_tol - 1) - c) / settle.

    Too fast and too near count as too hard, too slow and too far as too light. `numbers` [N] are
    the row's, by name.
    """
    excess, light = _stimuli(felt)
    pace = STEP / numbers["settle"]
    discomfort = now.discomfort + pace * (excess - now.discomfort)
    lightness = now.lightness + pace * (light - now.lightness)
    back = numbers["withdraw"] * discomfort - numbers["lean"] * lightness
    shift = back[:, None] * felt.away
    return dataclasses.replace(now, discomfort=discomfort, lightness=lightness, shift=shift)


def guarded(now: Reaction, felt: Felt, numbers: dict[str, jax.Array]) -> Reaction:
    """Return the next reaction by the second law: all or nothing, by a dose that is remembered.

    A person that has had more than `DOSE` flinches and holds its arm back until most of it is
    forgotten. One that misses pressure leans in further and further.
    """
    excess, light = _stimuli(felt)
    forgets = jnp.where(excess == 0.0, STEP / CALM, 0.0)
    dose = jnp.minimum(now.dose * (1.0 - forgets) + STEP * excess, 2.0 * DOSE)
    on = jnp.where(now.guarding > 0.0, dose > 0.3 * DOSE, dose > DOSE)
    guarding = jnp.where(on, now.guarding + STEP, 0.0)
    flinch = 1.0 + jnp.exp(-guarding / FLINCH)
    discomfort = jnp.where(on, 1.1 * numbers["limit"], dose / DOSE * 0.5)
    lightness = jnp.clip(now.lightness + STEP * jnp.where(light > 0.0, 0.5 * light, -1.0), 0.0, 1.5)
    back = numbers["withdraw"] * on * flinch - numbers["lean"] * lightness
    return Reaction(discomfort, lightness, dose, guarding, back[:, None] * felt.away)


def _stimuli(felt: Felt) -> tuple[jax.Array, jax.Array]:
    """Return the excess of touch, and whether there is too little of it [N]."""
    touched = felt.force > FELT
    too_near = LIGHT / jnp.maximum(felt.near, 1e-3) - 1.0
    too_fast = jnp.where(touched, felt.speed / FAST - 1.0, 0.0)
    excess = jnp.maximum(felt.force / felt.hurts - 1.0, jnp.maximum(too_fast, too_near))
    # A person that is pressed as hard as preferred, or harder, does not lean in for more speed.
    slow = (felt.speed < LIGHT) & (felt.force < felt.liked)
    light = (touched & ((felt.force < LIGHT * felt.liked) | slow)) | (felt.near > 1.0 / LIGHT)
    return jnp.clip(excess, 0.0, MOST), light.astype(jnp.float32)
