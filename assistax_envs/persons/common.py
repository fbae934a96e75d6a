"""Parts of the program that persons with an arm and with a head share: pure functions.

The families of a batch play in one program, and the few steps in which a family differs are chosen
by each person's own: `numbers["family"]` is its place among `FAMILIES`.

Chance is a hash of an episode's seed and the step, exact integers: the same seed and step give the
same numbers on every machine, whatever else is in the batch.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.persons import reaction
from assistax_envs.persons.rows import FAMILIES, WIDTH
from assistax_envs.tasks.gentle_base import STEP

LATEST = 16  # steps that a person remembers: 300 ms and now
SMOOTHED = 0.25  # s, over which sliding and rubbing are felt
LAPSE = 1.0  # s
REACTS = 0.2  # s, of a movement that needs no aim; Fitts' law adds to it
RESUMES = 0.3  # share of the limit below which a person helps again
CORRELATED = 0.8  # of a step's noise, what was there the step before
LAWS = {
    "spring": reaction.proportional,
    "muscle": reaction.guarded,
    "stepper": reaction.proportional,
}
# A stepper moves its intended posture in steps of STRIDE, and shows by nodding.
STEPPER = FAMILIES.index("stepper")
STRIDE = 12  # steps: 240 ms
NOD = 50  # steps of a nod and the pause after it: 1 s
_ODD = np.uint32(0x9E3779B9)  # the golden ratio's bits
_FIRST, _SECOND = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)  # of MurmurHash3's finaliser

Numbers = dict[str, jax.Array]  # [N] each, by name
T = TypeVar("T")


def numbers_of(row: jax.Array, places: Mapping[str, int]) -> Numbers:
    """Return the numbers of persons with rows [N, 31] by name, with their family."""
    named = {name: row[:, place] for name, place in places.items()}
    return named | {"family": row[:, WIDTH]}


def by_family(functions: Mapping[str, Callable[..., T]], numbers: Numbers, *args: Any) -> T:
    """Return the result of each person's own family's function; leaves have axis N first."""
    distinct = list(dict.fromkeys(functions[name] for name in FAMILIES))
    result = distinct[0](*args)
    for function in distinct[1:]:
        places = [place for place, name in enumerate(FAMILIES) if functions[name] is function]
        own = jnp.isin(numbers["family"], jnp.array(places, jnp.float32))
        result = chosen(own, function(*args), result)
    return result


def seed_of(words: jax.Array) -> jax.Array:
    """Return a seed [N] uint32 from any bits [N, W] uint32."""
    places = jnp.arange(1, words.shape[1] + 1, dtype=jnp.uint32)[None] * _ODD
    return _mixed(_mixed(words ^ places).sum(axis=1, dtype=jnp.uint32))


def uniform(seed: jax.Array, age: jax.Array, count: int) -> jax.Array:
    """Return numbers [N, count] in (0, 1) for seeds [N] at their ages [N], in steps."""
    places = jnp.arange(1, count + 1, dtype=jnp.uint32)[None] * _ODD
    steps = _mixed(seed + age.astype(jnp.uint32) * _SECOND)
    bits = _mixed(steps[:, None] ^ places) >> 8
    return (bits.astype(jnp.float32) + 0.5) * np.float32(2.0**-24)


def normal(share: jax.Array) -> jax.Array:
    """Return the quantiles of a standard normal distribution at shares in (0, 1)."""
    return jax.scipy.special.ndtri(share)


def _mixed(words: jax.Array) -> jax.Array:
    words = (words ^ (words >> 16)) * _FIRST
    words = (words ^ (words >> 13)) * _SECOND
    return words ^ (words >> 16)


def chosen(which: jax.Array, new: T, old: T) -> T:
    """Return the leaves [N, ...] of `new` in the simulations that `which` [N] marks, else `old`."""

    def choose(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(which.reshape(which.shape + (1,) * (new.ndim - 1)), new, old)

    return jax.tree.map(choose, new, old)


def remembered(past: jax.Array, newest: jax.Array, numbers: Numbers) -> tuple[jax.Array, jax.Array]:
    """Return the past [N, LATEST, K] with the newest [N, K] first, and the row of a delay ago."""
    past = jnp.concatenate([newest[:, None], past[:, :-1]], axis=1)
    steps = jnp.clip(jnp.round(numbers["delay"] / STEP), 0, LATEST - 1).astype(jnp.int32)
    return past, jnp.take_along_axis(past, steps[:, None, None], axis=1)[:, 0]


def stopped(before: jax.Array, discomfort: jax.Array, limit: jax.Array) -> jax.Array:
    """Return whether a person is hurt, and not yet willing again."""
    return jnp.where(before, discomfort > RESUMES * limit, discomfort > limit)


def lapsed(left: jax.Array, chance: jax.Array, numbers: Numbers) -> jax.Array:
    """Return the seconds [N] until attention is back; a small `chance` [N] loses it now."""
    begins = chance < numbers["lapses"] * (STEP / 60.0)
    return jnp.where(begins, LAPSE, jnp.maximum(left - STEP, 0.0))


def under_way(way: jax.Array, starts: jax.Array, lapsed: jax.Array) -> jax.Array:
    """Return the seconds since a movement began; it waits for attention."""
    return jnp.where(starts, 0.0, jnp.where(lapsed > 0.0, way, way + STEP))


def minimum_jerk(way: jax.Array, time: jax.Array) -> jax.Array:
    """Return the share of a movement that is done after `way` s: Flash and Hogan 1985."""
    t = jnp.clip(way / jnp.maximum(time, STEP), 0.0, 1.0)
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


def strides(age: jax.Array, held: jax.Array, intended: jax.Array, numbers: Numbers) -> jax.Array:
    """Return the posture [N, J] that muscles hold: a stepper's is that of its last stride."""
    now = (numbers["family"] != STEPPER) | (age % STRIDE == 0)
    return jnp.where(now[:, None], intended, held)


def nods(age: jax.Array, numbers: Numbers) -> jax.Array:
    """Return 1 for persons that show their liking at ages [N], else 0: a stepper pauses."""
    shows = (numbers["family"] != STEPPER) | (age % NOD < NOD // 2)
    return shows.astype(jnp.float32)


def shaken(before: jax.Array, normal: jax.Array) -> jax.Array:
    """Return correlated noise [N, J] from independent noise."""
    return CORRELATED * before + float(np.sqrt(1.0 - CORRELATED**2)) * normal


def tired(before: jax.Array, torque: jax.Array, most: jax.Array, numbers: Numbers) -> jax.Array:
    """Return the share of strength that is gone after a step of these torques [N, J]."""
    work = jnp.abs(torque / jnp.maximum(most, 1e-6)).mean(axis=1)
    return jnp.minimum(before + STEP / 60.0 * numbers["fatigue"] * work, 0.9)
