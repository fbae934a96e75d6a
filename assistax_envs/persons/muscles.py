"""From an intended posture to torques: a spring with effort, or pairs of muscles. Pure functions.

Shapes: N simulations, three joints. Units: N m, rad, s.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.tasks.gentle_base import STEP

# Stiffness of shoulder and elbow against their torques, N m/rad: Gomi and Osu 1998 as Tee et al.
# 2004 give it, from memory. Both joints of the shoulder have the shoulder's; the second of them
# turns in the elbow's plane, and its cross term is the mean of the two.
STILL = np.array([10.8, 10.8, 8.67], np.float32)
WITH_EFFORT = np.array([3.18, 3.18, 6.18], np.float32)
CROSS, CROSS_WITH_EFFORT = 2.67, 2.245
VISCOUS = 0.42  # s: damping is 0.42 K / sqrt(1 + qd^2), likewise from memory
# Beyond these a step of 20 ms is too long for the arm's inertia.
STIFFEST = np.array([60.0, 60.0, 30.0], np.float32)  # N m/rad
MOST_DAMPED = np.array([3.0, 3.0, 1.0], np.float32)  # N m s/rad beside the scene's own damping
# Of the resting stiffness, what waits for the delay: a reflex. The rest is the muscle's own. With
# all of it delayed an arm of 20 N m/rad, 3 N m s/rad and 0.3 s swings by itself (K d / b > pi / 2).
REFLEX = 0.3
FLEXORS = 2  # the joint whose stretched flexors a clinician tests: the elbow
FASTEST = 10.0  # rad/s at which a muscle has no force left, of the second family
CURVE = 0.25  # of Hill's force against speed
LENGTHENED = 1.4  # times the isometric force, at most, of a muscle that is drawn out
PRESSED = 0.05, 0.35  # co-contraction at ease, and what full discomfort adds


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Command:
    """Command to the muscles."""

    intended: jax.Array  # [N, 3] rad
    position: jax.Array  # [N, 3] rad
    late: jax.Array  # [N, 3] rad, the position a delay ago
    velocity: jax.Array  # [N, 3] rad/s
    weight: jax.Array  # [N, 3] N m that hold the arm, the share that this person carries
    tone: jax.Array  # [N] 0 to 1, from limp to at work
    discomfort: jax.Array  # [N]
    effort: jax.Array  # [N, 3] N m, smoothed torque
    most: jax.Array  # [N, 3] N m


def spring(
    command: Command, activation: jax.Array, numbers: dict[str, jax.Array], damping: np.ndarray
) -> tuple[jax.Array, jax.Array]:
    """Return the activation unchanged, and the torques [N, 3] of a spring.

    tau = a [K (q_eq - q) - D qd + s g(q)], K = scale (K0 + K1 |tau|) (1 + c), of which a share
    acts on the position of a delay ago. `damping` [3] is the scene's: D is what is missing.
    """
    scale, loud = numbers["stiffness"][:, None], (1.0 + command.discomfort)[:, None]
    effort = jnp.abs(command.effort)
    stiffness = scale * loud * (STILL[None] + WITH_EFFORT[None] * effort)
    stiffness = jnp.minimum(stiffness, STIFFEST[None])
    late = REFLEX * scale * STILL[None]
    error, late_error = command.intended - command.position, command.intended - command.late
    torque = (stiffness - late) * error + late * late_error
    cross = scale[:, 0] * (CROSS + CROSS_WITH_EFFORT * effort[:, 2])
    torque = torque.at[:, 1].add(cross * error[:, 2]).at[:, 2].add(cross * error[:, 1])
    viscous = VISCOUS * stiffness / jnp.sqrt(1.0 + command.velocity**2) - damping[None]
    torque = torque - jnp.clip(viscous, 0.0, MOST_DAMPED[None]) * command.velocity
    return activation, command.tone[:, None] * (torque + command.weight)


def muscle(
    command: Command, activation: jax.Array, numbers: dict[str, jax.Array], damping: np.ndarray
) -> tuple[jax.Array, jax.Array]:
    """Return activation [N, 3, 2] of flexors and extensors, and torques [N, 3].

    Every command is late, and a muscle follows it with a time constant of 50 to 80 ms; its force
    falls with the speed of shortening by Hill's curve.
    """
    delay = jnp.maximum(numbers["delay"], STEP)[:, None]
    gain = jnp.minimum(numbers["stiffness"][:, None] * STILL[None], damping[None] / delay)
    wanted = gain * (command.intended - command.late) + command.weight
    share = command.tone[:, None] * wanted / jnp.maximum(command.most, 1e-6)
    pressed = PRESSED[0] + PRESSED[1] * jnp.minimum(command.discomfort, 1.0)
    pressed = (command.tone * pressed)[:, None]
    excited = jnp.clip(
        jnp.stack([jnp.maximum(share, 0.0) + pressed, jnp.maximum(-share, 0.0) + pressed], axis=-1),
        0.0,
        1.0,
    )
    activation = followed(activation, excited, numbers)
    speed = command.velocity / FASTEST
    force = jnp.stack([_hill(speed), _hill(-speed)], axis=-1)
    pull = activation * force
    return activation, command.most * (pull[..., 0] - pull[..., 1])


def spasticity(numbers: dict[str, jax.Array], velocity: jax.Array) -> jax.Array:
    """Return torques [N, 3] of the elbow's flexors against stretching above the catch speed.

    `velocity` [N, 3] is smoothed; an elbow that extends has a negative one.
    """
    stretched = jnp.maximum(0.0, -velocity[:, FLEXORS] - numbers["catch_speed"])
    return jnp.zeros_like(velocity).at[:, FLEXORS].set(numbers["spasticity"] * stretched)


def followed(activation: jax.Array, excited: jax.Array, numbers: dict[str, jax.Array]) -> jax.Array:
    """Return activation [N, ...] a step later: it follows its command in 50 to 80 ms."""
    constant = 0.05 + 0.03 * jnp.clip((numbers["settle"] - 0.15) / 0.45, 0.0, 1.0)  # s
    share = (STEP / constant).reshape(-1, *(1,) * (activation.ndim - 1))
    return activation + share * (excited - activation)


def _hill(shortening: jax.Array) -> jax.Array:
    """Return the share of its isometric force that a muscle has at a speed of shortening."""
    faster = (1.0 - shortening) / (1.0 + shortening / CURVE)
    slower = LENGTHENED - (LENGTHENED - 1.0) * (1.0 + shortening) / (
        1.0 - 7.56 * shortening / CURVE
    )
    return jnp.where(shortening > 0.0, jnp.maximum(faster, 0.0), slower)
