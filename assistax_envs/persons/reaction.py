"""What a person shows: discomfort, stiffening, withdrawal, leaning in. Two laws, one a family.

This is what a robot can read with anybody. Shapes: N simulations; shifts [N, 3] rad are of the
intended posture.
"""

import dataclasses

import jax
import jax.numpy as jnp

from assistax_envs.tasks.gentle_base import FELT, STEP

MOST = 2.0  # discomfort beyond which nobody goes
LIGHT = 0.5  # share of what is liked, below which a person leans in
FAST = 2.0  # multiple of a liked speed, above which it is too fast
DOSE = 0.1  # s times excess of force, above which the second law guards
CALM = 1.0  # s, in which the second law forgets
FLINCH = 0.2  # s


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Felt:
    """What a person feels, after its delay."""

    force: jax.Array  # [N] N, of all touches
    hurts: jax.Array  # [N] N, from where on
    liked: jax.Array  # [N] N; 0 where no pressure is missed
    asks: jax.Array  # [N] N, a push that asks for help
    speed: jax.Array  # [N] what slides, as a share of what is liked; 1 where nobody minds
    near: jax.Array  # [N] distance of a robot that waits, likewise; 1 where nobody minds
    away: jax.Array  # [N, 3] unit joint direction that moves the skin away from the tool
    along: jax.Array  # [N, 3] unit joint direction that moves it along with the tool


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Reaction:
    """How a person feels; the carry of either law."""

    discomfort: jax.Array  # [N]
    lightness: jax.Array  # [N] 0 to 1: how much it misses pressure
    haste: jax.Array  # [N] -1 to 1: too slow, too fast
    dose: jax.Array  # [N] s, of the second law
    guarding: jax.Array  # [N] s since it began to guard, 0 if it does not; of the second law
    shift: jax.Array  # [N, 3] rad


def calm(n: int) -> Reaction:
    """Return the reaction of somebody whom nobody has touched yet."""
    zero = jnp.zeros(n, jnp.float32)
    return Reaction(zero, zero, zero, zero, zero, jnp.zeros((n, 3), jnp.float32))


def proportional(now: Reaction, felt: Felt, numbers: dict[str, jax.Array]) -> Reaction:
    """Return the next reaction by the first law: c' = (max(0, F / F_tol - 1) - c) / settle.

    Too near counts as too hard, too far as too light. `numbers` [N] are the row's, by name.
    """
    excess, light, haste = _stimuli(felt)
    pace = STEP / numbers["settle"]
    discomfort = now.discomfort + pace * (excess - now.discomfort)
    lightness = now.lightness + pace * (light - now.lightness)
    haste = now.haste + pace * (haste - now.haste)
    shift = _shift(
        numbers["withdraw"] * discomfort - numbers["lean"] * lightness,
        numbers["withdraw"] * jnp.maximum(haste, 0.0) + numbers["lean"] * jnp.minimum(haste, 0.0),
        felt,
    )
    return dataclasses.replace(
        now, discomfort=discomfort, lightness=lightness, haste=haste, shift=shift
    )


def guarded(now: Reaction, felt: Felt, numbers: dict[str, jax.Array]) -> Reaction:
    """Return the next reaction by the second law: all or nothing, by a dose that is remembered.

    Who has had more than `DOSE` flinches and holds its arm back until most of it is forgotten; who
    misses pressure leans in further and further.
    """
    excess, light, haste = _stimuli(felt)
    forgets = jnp.where(felt.force < 0.7 * felt.hurts, STEP / CALM, 0.0)
    dose = jnp.minimum(now.dose * (1.0 - forgets) + STEP * excess, 2.0 * DOSE)
    on = jnp.where(now.guarding > 0.0, dose > 0.3 * DOSE, dose > DOSE)
    guarding = jnp.where(on, now.guarding + STEP, 0.0)
    flinch = 1.0 + jnp.exp(-guarding / FLINCH)
    discomfort = jnp.where(on, 1.1 * numbers["limit"], dose / DOSE * 0.5)
    lightness = jnp.clip(now.lightness + STEP * jnp.where(light > 0.0, 0.5 * light, -1.0), 0.0, 1.5)
    haste = jnp.clip(now.haste + STEP * (jnp.sign(haste) - now.haste), -1.0, 1.0)
    shift = _shift(
        numbers["withdraw"] * on * flinch - numbers["lean"] * lightness,
        numbers["lean"] * haste,
        felt,
    )
    return Reaction(discomfort, lightness, haste, dose, guarding, shift)


def _stimuli(felt: Felt) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return excess of force, lightness of touch and haste [N]."""
    touched = felt.force > FELT
    too_near = jnp.maximum(0.0, LIGHT / jnp.maximum(felt.near, 1e-3) - 1.0)
    excess = jnp.minimum(jnp.maximum(felt.force / felt.hurts - 1.0, too_near), MOST)
    light = (touched & (felt.force < LIGHT * felt.liked)) | (felt.near > 1.0 / LIGHT)
    fast = jnp.clip(felt.speed / FAST - 1.0, 0.0, 1.0)
    slow = jnp.clip(1.0 - felt.speed / LIGHT, 0.0, 1.0)
    return excess, light.astype(jnp.float32), jnp.where(touched, fast - slow, 0.0)


def _shift(back: jax.Array, along: jax.Array, felt: Felt) -> jax.Array:
    """Return the shift [N, 3] that is so far back from the tool and along with it, rad."""
    return back[:, None] * felt.away + along[:, None] * felt.along
