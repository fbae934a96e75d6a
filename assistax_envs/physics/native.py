"""MuJoCo's C engine on a thread pool, called from inside JAX programs."""

import copy
import threading

import jax
import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np

from assistax_envs.mujoco_warnings import warnings_logged
from assistax_envs.physics.base import SUBSTEPS, PhysicsState, felt_sensors, values_width

# A Batch must not be entered by two threads, and uses all cores, so programs on several devices
# take turns.
_LOCK = threading.Lock()


class NativePhysics:
    """Physics by a `mujoco.batch.Batch` for each batch size; results depend on arguments alone."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = copy.copy(model)
        # A diverged simulation must stay so to be counted; MuJoCo's C engine would restart it.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._batches: dict[int, mujoco.batch.Batch] = {}
        self._width = values_width(model)
        # [P, 3] columns of the forces that are felt
        self._felt = model.sensor_adr[felt_sensors(model)][:, None] + np.arange(3)

    def forward(self, state: PhysicsState, joint_range: jax.Array) -> jax.Array:
        """See `Physics.forward`."""
        control = jnp.zeros((state.qpos.shape[0], self.model.nu), jnp.float32)
        sensors = jax.ShapeDtypeStruct((state.qpos.shape[0], self._width), jnp.float32)
        return jax.pure_callback(self._forward, sensors, state, control, joint_range)

    def step(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array
    ) -> tuple[PhysicsState, jax.Array]:
        """See `Physics.step`."""
        fields = (state.qpos, state.qvel, state.warmstart)
        shapes = tuple(jax.ShapeDtypeStruct(field.shape, jnp.float32) for field in fields)
        sensors = jax.ShapeDtypeStruct((state.qpos.shape[0], self._width), jnp.float32)
        after, values = jax.pure_callback(
            self._step, (shapes, sensors), state, control, joint_range
        )
        return PhysicsState(*after), values

    def _forward(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array
    ) -> np.ndarray:
        """Return the sensor values under zero control, as a NumPy array."""
        values = _values(state, control, joint_range)
        with _LOCK, warnings_logged():
            batch = self._load(values)
            batch.forward()
            sensors = np.asarray(batch.bind("sensordata"), np.float32)
            return np.column_stack([sensors, self._peaks(sensors)])

    def _step(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Return qpos, qvel and warmstart after a control step, and the values, as NumPy arrays."""
        values = _values(state, control, joint_range)
        with _LOCK, warnings_logged():
            batch = self._load(values)
            peaks = self._advance(batch)
            names = ("qpos", "qvel", "qacc_warmstart", "sensordata")
            qpos, qvel, warmstart, sensors = (
                np.asarray(batch.bind(name), np.float32) for name in names
            )
            return (qpos, qvel, warmstart), np.column_stack([sensors, peaks])

    def _advance(self, batch: mujoco.batch.Batch) -> np.ndarray:
        """Advance a batch by a control step; return the largest forces of substeps [N, P + 1]."""
        if not self._felt.size:
            batch.step(nstep=SUBSTEPS)
            return self._peaks(np.asarray(batch.bind("sensordata"), np.float32))
        peaks = []
        for _ in range(SUBSTEPS):
            batch.step(nstep=1)
            peaks.append(self._peaks(np.asarray(batch.bind("sensordata"), np.float32)))
        return np.max(peaks, axis=0)

    def _peaks(self, sensors: np.ndarray) -> np.ndarray:
        """Return the sizes of felt forces and their sum [N, P + 1]; [N, 0] without sensors."""
        size = np.linalg.norm(sensors[:, self._felt], axis=-1)
        return np.column_stack([size, size.sum(axis=1)]) if self._felt.size else size

    def _load(self, values: dict[str, np.ndarray]) -> mujoco.batch.Batch:
        """Return the batch of the values' size, made on first use, after writing the values."""
        size = len(values["qpos"])
        if size not in self._batches:
            self._batches[size] = mujoco.batch.Batch(self.model, size)
            # Outputs are copied out only by calls after their first bind.
            self._batches[size].bind("sensordata")
        batch = self._batches[size]
        for name, value in values.items():
            field = batch.expand(name) if name == "jnt_range" else batch.bind(name)
            field[:] = value
        return batch


def _values(
    state: PhysicsState, control: jax.Array, joint_range: jax.Array
) -> dict[str, np.ndarray]:
    """Return a batch's inputs by MuJoCo's names.

    Call it outside the lock: it may wait for arrays of another device, and other threads must not
    wait meanwhile.
    """
    return {
        "jnt_range": np.asarray(joint_range),
        "qpos": np.asarray(state.qpos),
        "qvel": np.asarray(state.qvel),
        "qacc_warmstart": np.asarray(state.warmstart),
        "ctrl": np.asarray(control),
    }
