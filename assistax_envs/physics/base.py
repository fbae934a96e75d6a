"""What every physics backend does: advance a batch of simulations of one model."""

import dataclasses
from typing import Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

FELT_NUMBERS = 9  # of a felt contact: force, normal and tangent
SUBSTEPS = 4  # physics steps of 5 ms in one control step of 20 ms
LARGEST_STATE = 1e10  # beyond this MuJoCo itself calls a state unstable (mjMAXVAL)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PhysicsState:
    """All that a simulation carries from one control step to the next; float32, axis N first."""

    qpos: jax.Array  # [N, nq] joint positions, rad
    qvel: jax.Array  # [N, nv] joint velocities, rad/s
    # [N, nv] accelerations that start the constraint solver, rad/s^2; what `fused` keeps here, no
    # number depends on.
    warmstart: jax.Array


class Physics(Protocol):
    """A backend. Its methods stand inside jit and scan, and may not be mapped: they are batched."""

    model: mujoco.MjModel

    def forward(self, state: PhysicsState, joint_range: jax.Array) -> jax.Array:
        """Return the sensor values [N, `values_width`] of `state` under zero control.

        `joint_range` [N, njnt, 2] replaces the model's joint limits, in rad.
        """
        ...

    def step(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array
    ) -> tuple[PhysicsState, jax.Array]:
        """Advance by `SUBSTEPS` under `control` [N, nu], and return the sensor values as well.

        As MuJoCo defines them, those are of the state before the last substep. Where contacts are
        felt, the largest forces of all substeps follow: of each of `felt_sensors`, and of their
        sum, in N.
        """
        ...


def felt_sensors(model: mujoco.MjModel) -> np.ndarray:
    """Return the ids of sensors of contact forces with frames: those of the gentle scenes."""
    contact = model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT
    return np.flatnonzero(contact & (model.sensor_dim == FELT_NUMBERS))


def values_width(model: mujoco.MjModel) -> int:
    """Return how many numbers a simulation's sensor values are."""
    felt = len(felt_sensors(model))
    return model.nsensordata + (felt + 1 if felt else 0)


def diverged(physics: PhysicsState, values: jax.Array, control: jax.Array) -> jax.Array:
    """Return [N]: whether a value left MuJoCo's stable range; NaN counts as diverged.

    Controls count because MuJoCo's C engine takes a NaN among them for zeros without a word.
    """
    rows = jnp.concatenate([physics.qpos, physics.qvel, values, control], axis=-1)
    return ~jnp.all(jnp.abs(rows) < LARGEST_STATE, axis=-1)
