"""Script of gentle brushing, and its numbers."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from assistax_envs.tasks.chain import Chain, Numbers, Script, capped
from assistax_envs.tasks.skin_script import rubbing

NUMBERS: dict[str, float] = {
    "approach": 6.05,
    "fast": 0.0952,
    "above": 0.0162,
    "inside": 0.00344,
    "over": 0.0137,
    "rub": 8.2,
    "slide": 0.0937,
    "force": 1.92,
    "soften": 0.0304,
    "press": 0.0384,
    "lift": 0.0517,
    "round": 0.0164,
    "gate": 0.0341,
    "turn": 0.1,
    "damping": 0.0015,
    "ahead": 0.0,
    "drag": 0.0,
}
# Of the script that is told the wishes, in place of those above.
CAREFUL: dict[str, float] = {
    "heed": 0.837,
    "pace": 1.27,
    "ahead": 0.661,
    "drag": 1.03,
    "soften": 0.00769,
    "approach": 5.18,
    "fast": 0.126,
    "above": 0.0174,
    "inside": 0.00398,
    "over": 0.0117,
    "rub": 6.73,
    "press": 0.0727,
    "lift": 0.0388,
    "round": 0.0201,
    "gate": 0.0339,
    "turn": 0.143,
    "damping": 0.00247,
}
# Lengths in m, speeds in m/s, forces in N.
RANGES: dict[str, tuple[float, float]] = {
    "approach": (1.0, 8.0),
    "fast": (0.05, 0.25),
    "above": (0.005, 0.03),  # the place, until it is shown
    "inside": (0.001, 0.01),  # the same in the mouth
    "over": (0.008, 0.02),  # from a place's middle along its row, up to which the brush presses
    "rub": (3.0, 20.0),
    "slide": (0.01, 0.12),
    "force": (0.3, 3.0),
    "soften": (0.005, 0.05),
    "press": (0.005, 0.05),
    "lift": (0.01, 0.15),
    "round": (0.005, 0.03),  # before the lips, on the way from one place to another
    "gate": (0.02, 0.06),  # before the lips, on the way in
    "turn": (0.02, 0.3),
    "damping": (1e-4, 5e-3),
    "ahead": (0.0, 1.2),  # share of the force that is kept, which the motors press with anyway
    "drag": (0.0, 1.5),  # friction that is made up for, as a share of the force
}


def brush(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Wait before the place until it is shown, then to and fro; in between the lips."""
    mouth, forward = obs[:, 24:27], obs[:, 27:30]
    out, beside = 0.1 * obs[:, 30:31], 0.1 * jnp.linalg.norm(obs[:, 31:33], axis=-1, keepdims=True)
    towards, normal = 0.2 * obs[:, 39:42], obs[:, 42:45]
    inner = obs[:, 56:62].sum(axis=-1, keepdims=True) > 0.5
    shown, force = obs[:, 63:64] > 0.5, 5.0 * obs[:, 68:69]
    height = -(towards * normal).sum(-1, keepdims=True)
    aside = towards + height * normal
    way = aside + (jnp.where(inner, n["inside"], n["above"]) - height) * normal
    ahead = (way * forward).sum(-1, keepdims=True)
    far = jnp.linalg.norm(way - ahead * forward, axis=-1, keepdims=True) > 0.02
    way = way + jnp.where(far & ~inner, n["round"] - out - ahead, 0.0) * forward
    # From the place's middle along its row: 8 mm to the end that comes next.
    at = jnp.abs(0.008 * obs[:, 62:63] - (towards * obs[:, 45:48]).sum(-1, keepdims=True))
    rubs = (at < n["over"]) & (jnp.abs(aside).max(axis=1, keepdims=True) < 0.03)
    at_place = jnp.where(
        rubs & (height > -0.002) & shown,
        rubbing(chain, n, obs, normal, force, capped(n["rub"] * aside, n["slide"])),
        capped(n["approach"] * way, n["fast"]),
    )
    # Between the lips, and before them until it may go in there.
    where = jnp.where(inner & (beside < 0.01) & shown, -0.01, n["gate"])
    to_mouth = capped(n["approach"] * (mouth + where * forward - obs[:, 14:17]), n["fast"])
    velocity = jnp.where(inner == ((out < -0.002) & (beside < 0.03)), at_place, to_mouth)
    return chain.drive(obs, velocity, -forward, turn=n["turn"], damping=n["damping"])


def keep_to(n: Numbers, wishes: Mapping[str, jax.Array]) -> Numbers:
    """Return the numbers of a script that keeps to the liked press and speed."""
    return {"force": n["heed"] * wishes["press"], "slide": n["pace"] * wishes["speed"]}


SCRIPT = Script(brush, NUMBERS, RANGES, told=keep_to, careful=CAREFUL)
