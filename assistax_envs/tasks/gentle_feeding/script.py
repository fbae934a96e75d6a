"""Script of gentle feeding, and its numbers."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from assistax_envs.tasks.chain import Chain, Numbers, Script, capped

NUMBERS: dict[str, float] = {
    "approach": 4.0,
    "fast": 0.15,
    "wait": 0.08,
    "open": 0.5,
    "deep": 0.02,
    "leave": 0.12,
    "turn": 0.1,
    "damping": 0.001,
}
# Of the script that is told the wishes, in place of those above.
CAREFUL: dict[str, float] = {}
# Lengths in m, speeds in m/s, forces in N.
RANGES: dict[str, tuple[float, float]] = {
    "approach": (1.0, 8.0),
    "fast": (0.05, 0.3),
    "wait": (0.03, 0.2),  # before the lips, until the mouth opens
    "open": (0.3, 0.8),  # of the jaw's range, from where on the spoon goes in
    "deep": (0.011, 0.029),  # behind the lips
    "leave": (0.09, 0.2),  # before the lips, after a bite
    "turn": (0.02, 0.3),
    "damping": (1e-4, 5e-3),
}


def feed(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Wait before the mouth, into it while it is open, and back after a bite."""
    forward = obs[:, 27:30]  # the mouth's axis
    waits, enters, takes = (obs[:, 37 + stage : 38 + stage] for stage in range(3))
    goes_in = takes + enters * (obs[:, 36:37] > n["open"])
    where = jnp.where(waits + enters > 0.5, n["wait"], n["leave"])
    way = obs[:, 24:27] + jnp.where(goes_in > 0.5, -n["deep"], where) * forward - obs[:, 14:17]
    return chain.drive(
        obs,
        capped(n["approach"] * way, n["fast"]),
        -forward,
        turn=n["turn"],
        damping=n["damping"],
        upright=True,
    )


def keep_to(n: Numbers, wishes: Mapping[str, jax.Array]) -> Numbers:
    """Return the numbers of a script that waits and comes in as liked."""
    return {"wait": wishes["wait"], "deep": wishes["depth"]}


SCRIPT = Script(feed, NUMBERS, RANGES, told=keep_to, careful=CAREFUL)
