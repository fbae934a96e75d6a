"""Script of arm assist."""

import jax
import jax.numpy as jnp

from assistax_envs.tasks.chain import DOWN, Chain, Numbers, Script, capped, down

UNDER = 0.045 * DOWN  # m, from the middle of the forearm to where the bar carries it


def lift(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Bring the bar under the forearm, then with it to the waist."""
    del n
    to_section, distance, to_waist = obs[:, 30:33], obs[:, 33:34], obs[:, 43:46]
    under = to_section + UNDER
    carry = capped(4.0 * to_waist, 0.5) + 2.0 * to_section
    return chain.drive(obs, jnp.where(distance < 0.08, carry, capped(4.0 * under, 0.3)), down(obs))


SCRIPT = Script(lift)
