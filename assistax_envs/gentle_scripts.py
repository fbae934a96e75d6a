"""Scripts of the gentle tasks as they are now: what they do, and the numbers that they do it by.

The numbers are the best of a search with persons (`assistax-zoo gates persons TASK --only search`).
A script sees what a trained robot sees, and has no memory.

Shapes: N simulations; observations [N, O] of the robot, actions [N, 7]. In the code h is the height
of a point over the tool along the skin's normal, negative while the tool is above the skin.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import mujoco

from assistax_envs.registered import REGISTERED
from assistax_envs.scripted import DOWN, Chain, capped, scripted_robot
from assistax_envs.scripted import SCRIPTS as OF_PAPER

Numbers = Mapping[str, Any]
# What a search tries for each number, from least to most. Lengths in m, speeds in m/s, forces in N;
# "yield" is m/s for each N of the force that the tool feels, along it.
_SKIN = {
    "approach": (1.0, 6.0),  # 1/s, of the way above the skin
    "fast": (0.1, 0.4),
    "hover": (0.02, 0.1),
    "yield": (-0.01, 0.01),
    "force": (1.5, 8.0),  # that the touch is kept at
    "soften": (0.001, 0.02),  # m/s for each N beside it
    "press": (0.01, 0.06),
    "lift": (0.01, 0.2),
    "stop": (8.0, 60.0),  # above it the tool only lifts
    "touch": (0.1, 1.0),  # above it the tool is on the skin
    "lean": (0.0, 2.0),  # weight of the skin's normal in where the shaft points
    "turn": (0.0, 0.2),
    "facing": (-1.0, 0.5),  # least cosine between the skin's normal and up
    "damping": (2e-4, 5e-3),
}
RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "gentle_scratch": _SKIN
    | {
        "over": (0.01, 0.06),  # aside of the itch, up to which the tool goes down
        "descend": (0.02, 0.1),
        "rub": (4.0, 30.0),  # 1/s, towards the itch's end
        "slide": (0.02, 0.1),
    },
    "gentle_bath": _SKIN
    | {
        "over": (0.01, 0.1),
        "keep": (0.02, 0.3),  # the same, of a tool that is on the skin
        "back": (0.005, 0.05),  # beyond a point, where the tool turns back
        "slide": (0.03, 0.12),
        "turn": (0.0, 0.3),
        "damping": (5e-5, 5e-3),
    },
    "gentle_feeding": {
        "approach": (1.0, 8.0),
        "fast": (0.05, 0.3),
        "wait": (0.03, 0.2),  # before the lips, until the mouth opens
        "open": (0.3, 0.8),  # of the jaw's range, from where on the spoon goes in
        "deep": (0.011, 0.029),  # behind the lips
        "leave": (0.09, 0.2),  # before the lips, after a bite
        "turn": (0.02, 0.3),
        "damping": (1e-4, 5e-3),
    },
    "gentle_brushing": {
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
    },
    "gentle_lift": {
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
    },
}
# The numbers that the scripts play by.
OWN: dict[str, dict[str, float]] = {
    "gentle_scratch": {
        "approach": 2.03,
        "fast": 0.19,
        "hover": 0.0226,
        "yield": -0.00685,
        "force": 5.53,
        "soften": 0.00669,
        "press": 0.0338,
        "lift": 0.0506,
        "stop": 57.5,
        "touch": 0.411,
        "lean": 1.36,
        "turn": 0.0329,
        "facing": -0.952,
        "damping": 0.00186,
        "over": 0.0201,
        "descend": 0.0453,
        "rub": 10.3,
        "slide": 0.0799,
    },
    "gentle_bath": {
        "approach": 2.83,
        "fast": 0.332,
        "hover": 0.0492,
        "yield": 0.00147,
        "force": 3.98,
        "soften": 0.0159,
        "press": 0.0423,
        "lift": 0.0435,
        "stop": 41.3,
        "touch": 0.773,
        "lean": 1.12,
        "turn": 0.228,
        "facing": -1.0,
        "damping": 0.00392,
        "over": 0.055,
        "keep": 0.142,
        "back": 0.0154,
        "slide": 0.0634,
    },
    "gentle_feeding": {
        "approach": 4.0,
        "fast": 0.15,
        "wait": 0.08,
        "open": 0.5,
        "deep": 0.02,
        "leave": 0.12,
        "turn": 0.1,
        "damping": 0.001,
    },
    "gentle_brushing": {
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
    },
    "gentle_lift": {
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
    },
}


def script_of(
    task: str, model: mujoco.MjModel, numbers: Numbers | None = None
) -> Callable[[jax.Array], jax.Array]:
    """Return a task's script: from observations [N, O] of the robot to actions [N, 7].

    Args:
        task: one of `TASKS`.
        model: of its scene.
        numbers: in place of some of the script's own, if it has any.
    """
    if task not in OWN:
        return scripted_robot(task, model)
    chosen = {**OWN[task], **(numbers or {})}
    return jax.tree_util.Partial(globals()[REGISTERED[task].script], Chain(model), chosen)


def stroke(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Gentle scratch: above the end of the itch, down to a light force, then from end to end."""
    towards, normal, force = obs[:, 30:33], obs[:, 37:40], 10.0 * obs[:, 43:44]
    aside, off, above = _above(n, obs, towards, normal)
    descend = 2.0 * aside - n["descend"] * normal
    rub = capped(n["rub"] * aside, n["slide"]) + _pressing(n, force) * normal
    on = (off < n["over"]) & (normal[:, 2:] > n["facing"])
    velocity = jnp.where(on, jnp.where(force > n["touch"], rub, descend), above)
    return _drive(chain, n, obs, normal, force, velocity)


def wipe(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Gentle bath: to the nearest point that faces the pad, then along the skin to the next."""
    towards, normal, force = obs[:, 30:33], obs[:, 33:36], 10.0 * obs[:, 37:38]
    aside, off, above = _above(n, obs, towards, normal)
    # Over the point and beyond it, to and fro along the arm: on until past it, then back.
    along = _unit(obs[:, 24:27] - obs[:, 27:30])
    onward = jnp.sign((chain.velocity(obs) * along).sum(-1, keepdims=True)) * along
    way = jnp.where(off < n["back"], onward, aside / jnp.maximum(off, 1e-3))
    rub = n["slide"] * way + _pressing(n, force) * normal
    on = (off < n["over"]) | ((off < n["keep"]) & (force > n["touch"]))
    velocity = jnp.where(on & (normal[:, 2:] > n["facing"]), rub, above)
    return _drive(chain, n, obs, normal, force, velocity)


def bring(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Gentle lift: the bar under the forearm, with it to the waist, and away once it lies there."""
    to_section, to_waist, left = obs[:, 30:33], obs[:, 34:37], obs[:, 37:38]
    force, down = 10.0 * obs[:, 38:39], jnp.asarray(DOWN)
    along = _unit(obs[:, 24:27] - obs[:, 27:30])  # of an arm that hangs straight: towards the hand
    under = to_section + n["handward"] * along + n["under"] * down
    # The forearm turns about the elbow: what is across it lifts, what is along it slips.
    aim = to_waist - n["rise"] * _share(to_waist, 0.2) * down
    across = aim - n["square"] * (aim * along).sum(-1, keepdims=True) * along
    carry = capped(n["carry"] * across, n["fast"]) + n["follow"] * under
    carry = carry + n["soften"] * jnp.maximum(force - n["force"], 0.0) * down
    first = capped(n["approach"] * (under + n["below"] * _share(under, 0.1) * down), n["calm"])
    velocity = jnp.where(jnp.linalg.norm(under, axis=-1, keepdims=True) < n["near"], carry, first)
    gap = jnp.linalg.norm(to_section, axis=-1, keepdims=True) - n["wait"]
    wait = capped(n["leave"] * gap * _unit(to_section), 0.2)
    velocity = jnp.where(left < n["laid"], wait, velocity)
    shaft = jnp.broadcast_to(down, velocity.shape)
    return chain.drive(obs, velocity, shaft, turn=n["turn"], damping=n["damping"])


def feed(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Gentle feeding: wait before the mouth, into it while it is open, and back after a bite."""
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


def brush(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Gentle brushing: before the place until it is shown, then to and fro; in between the lips."""
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
        capped(n["rub"] * aside, n["slide"]) + _pressing(n, force) * normal,
        capped(n["approach"] * way, n["fast"]),
    )
    # Between the lips, and before them until it may go in there.
    where = jnp.where(inner & (beside < 0.01) & shown, -0.01, n["gate"])
    to_mouth = capped(n["approach"] * (mouth + where * forward - obs[:, 14:17]), n["fast"])
    velocity = jnp.where(inner == ((out < -0.002) & (beside < 0.03)), at_place, to_mouth)
    return chain.drive(obs, velocity, -forward, turn=n["turn"], damping=n["damping"])


def _above(
    n: Numbers, obs: jax.Array, towards: jax.Array, normal: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the way aside to a point, its length, and the velocity that leads above it."""
    h = (towards * normal).sum(-1, keepdims=True)
    aside = towards - h * normal
    above = capped(n["approach"] * (aside + (n["hover"] + h) * normal), n["fast"])
    off = jnp.linalg.norm(aside, axis=-1, keepdims=True)
    return aside, off, above + capped(n["yield"] * obs[:, 21:24], n["fast"])


def _pressing(n: Numbers, force: jax.Array) -> jax.Array:
    """Return the speed outward [N, 1] that brings the force to the one that is kept."""
    return jnp.clip(n["soften"] * (force - n["force"]), -n["press"], n["lift"])


def _drive(
    chain: Chain, n: Numbers, obs: jax.Array, normal: jax.Array, force: jax.Array, velocity: Any
) -> jax.Array:
    """Move the tool, and lift it where it presses too hard; its shaft leans into the skin."""
    velocity = jnp.where(force > n["stop"], n["lift"] * normal, velocity)
    shaft = capped(jnp.asarray(DOWN) - n["lean"] * normal, 1.0)
    return chain.drive(obs, velocity, shaft, turn=n["turn"], damping=n["damping"])


def _unit(vector: jax.Array) -> jax.Array:
    return vector / jnp.maximum(jnp.linalg.norm(vector, axis=-1, keepdims=True), 1e-6)


def _share(way: jax.Array, whole: float) -> jax.Array:
    """Return how far [N, 1] ways [N, 3] lead aside, as a share of `whole` m that is at most 1."""
    return jnp.minimum(1.0, jnp.linalg.norm(way[:, :2], axis=-1, keepdims=True) / whole)


# The script of each task, in the order of `REGISTERED`.
SCRIPTS: dict[str, Callable[..., jax.Array]] = {
    name: globals()[task.script] if name in OWN else OF_PAPER[name]
    for name, task in REGISTERED.items()
}
