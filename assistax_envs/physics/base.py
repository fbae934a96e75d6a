"""Protocol of a physics backend, which advances a batch of simulations of one model."""

import dataclasses
from typing import Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

FELT_NUMBERS = 9  # of a felt contact: force, normal and tangent
SUBSTEPS = 4  # physics steps of 5 ms in one control step of 20 ms
LARGEST_STATE = 1e10  # beyond this MuJoCo calls a state unstable (mjMAXVAL)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PhysicsState:
    """State of a simulation between two control steps; float32, axis N first."""

    qpos: jax.Array  # [N, nq] joint positions, rad
    qvel: jax.Array  # [N, nv] joint velocities, rad/s
    # [N, nv] accelerations that start the constraint solver, rad/s^2. In `fused` the field holds
    # only the solver's effort, on which no result depends.
    warmstart: jax.Array


class Physics(Protocol):
    """Backend. Its methods are batched: they stand inside jit and scan, but not inside vmap."""

    model: mujoco.MjModel

    def forward(self, state: PhysicsState, joint_range: jax.Array) -> jax.Array:
        """Return the sensor values [N, `values_width`] of `state` under zero control.

        `joint_range` [N, njnt, 2] replaces the model's joint limits, in rad.
        """
        ...

    def step(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array
    ) -> tuple[PhysicsState, jax.Array]:
        """Return state and sensor values after `SUBSTEPS` under `control` [N, nu].

        As MuJoCo defines them, the values are those of the state before the last substep. If the
        model has `felt_sensors`, the largest forces of all substeps follow: of each of them, and of
        their sum, in N.
        """
        ...


def felt_sensors(model: mujoco.MjModel) -> np.ndarray:
    """Return the ids of sensors of contact forces with frames, which gentle scenes have."""
    contact = model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT
    return np.flatnonzero(contact & (model.sensor_dim == FELT_NUMBERS))


def values_width(model: mujoco.MjModel) -> int:
    """Return the number of a simulation's sensor values."""
    felt = len(felt_sensors(model))
    return model.nsensordata + (felt + 1 if felt else 0)


def diverged(physics: PhysicsState, values: jax.Array, control: jax.Array) -> jax.Array:
    """Return a mask [N] of simulations with a value outside MuJoCo's stable range, or NaN.

    Controls count because MuJoCo's C engine takes a NaN among them for zeros without a word.
    """
    rows = jnp.concatenate([physics.qpos, physics.qvel, values, control], axis=-1)
    return ~jnp.all(jnp.abs(rows) < LARGEST_STATE, axis=-1)
