"""Script of gentle lift, and its numbers."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from assistax_envs.tasks.base import unit
from assistax_envs.tasks.chain import DOWN, Chain, Numbers, Script, capped
from assistax_envs.tasks.gentle_lift.person import ACROSS, MIDDLE

NUMBERS: dict[str, float] = {
    "approach": 2.84,
    "calm": 0.222,
    "handward": 0.12,
    "under": 0.0513,
    "below": 0.0869,
    "near": 0.131,
    "carry": 8.0,
    "fast": 0.432,
    "follow": 2.21,
    "rise": 0.0945,
    "square": 0.543,
    "laid": 0.0476,
    "wait": 0.205,
    "leave": 2.78,
    "soften": 0.00603,
    "force": 13.5,
    "turn": 0.211,
    "damping": 0.00241,
    "place": MIDDLE,
}
# Of the script that is told the wishes, in place of those above.
CAREFUL: dict[str, float] = {}
# Lengths in m, speeds in m/s, forces in N.
RANGES: dict[str, tuple[float, float]] = {
    "approach": (1.0, 8.0),
    "calm": (0.1, 0.6),  # m/s on the way there
    "handward": (0.0, 0.2),  # from the forearm's middle, where the bar lifts
    "under": (0.03, 0.08),
    "below": (0.0, 0.15),  # further below while the bar is not yet under the arm
    "near": (0.03, 0.15),
    "carry": (2.0, 15.0),
    "fast": (0.2, 1.5),
    "follow": (0.5, 6.0),
    "rise": (0.0, 0.25),  # above the way to the waist while it is long
    "square": (0.0, 1.0),  # how much of the way along the arm is left out
    "laid": (0.02, 0.12),  # from the waist, where the bar lets go
    "wait": (0.12, 0.5),  # from the arm, once it lies there
    "leave": (0.5, 4.0),
    "soften": (0.0, 0.02),  # m/s downwards for each N above "force"
    "force": (10.0, 45.0),
    "turn": (0.0, 0.4),
    "damping": (1e-4, 5e-3),
    "place": (0.1, 0.3),  # of the forearm across the waist
}


def bring(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Bring the bar under the forearm, with it to the waist, and away once it lies there."""
    to_section = obs[:, 30:33]
    to_waist = obs[:, 34:37] + (n["place"] - MIDDLE) * jnp.asarray([ACROSS], jnp.float32)
    left = jnp.linalg.norm(to_waist, axis=-1, keepdims=True)
    force, down = 10.0 * obs[:, 38:39], jnp.asarray(DOWN)
    along = unit(obs[:, 24:27] - obs[:, 27:30])  # of an arm that hangs straight: towards the hand
    under = to_section + n["handward"] * along + n["under"] * down
    # The forearm turns about the elbow: what is across it lifts, what is along it slips.
    aim = to_waist - n["rise"] * _share(to_waist, 0.2) * down
    across = aim - n["square"] * (aim * along).sum(-1, keepdims=True) * along
    carry = capped(n["carry"] * across, n["fast"]) + n["follow"] * under
    carry = carry + n["soften"] * jnp.maximum(force - n["force"], 0.0) * down
    first = capped(n["approach"] * (under + n["below"] * _share(under, 0.1) * down), n["calm"])
    velocity = jnp.where(jnp.linalg.norm(under, axis=-1, keepdims=True) < n["near"], carry, first)
    gap = jnp.linalg.norm(to_section, axis=-1, keepdims=True) - n["wait"]
    wait = capped(n["leave"] * gap * unit(to_section), 0.2)
    velocity = jnp.where(left < n["laid"], wait, velocity)
    shaft = jnp.broadcast_to(down, velocity.shape)
    return chain.drive(obs, velocity, shaft, turn=n["turn"], damping=n["damping"])


def _share(way: jax.Array, whole: float) -> jax.Array:
    """Return how far [N, 1] ways [N, 3] lead aside, as a share of `whole` m that is at most 1."""
    return jnp.minimum(1.0, jnp.linalg.norm(way[:, :2], axis=-1, keepdims=True) / whole)


def keep_to(n: Numbers, wishes: Mapping[str, jax.Array]) -> Numbers:
    """Return the numbers of a script that lays the arm and waits as liked."""
    return {"wait": wishes["distance"], "place": wishes["place"]}


SCRIPT = Script(bring, NUMBERS, RANGES, told=keep_to, careful=CAREFUL)
