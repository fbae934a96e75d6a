"""The fused engine as a physics backend: one custom call of XLA is a whole control step."""

import functools
import threading
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs import compiled
from assistax_envs.physics.base import SUBSTEPS, PhysicsState, values_width
from assistax_envs.physics.fused.program import generate
from assistax_envs.physics.fused.runtime import cpu, gpu, toolchain

_REGISTERED: set[str] = set()  # names of calls that XLA of this process has
_REGISTERING = threading.Lock()


class FusedPhysics:
    """Generated for one model; a simulation's result depends on its own arguments alone.

    No warm start outlives a control step. In its field stands, in column 0, how much the solver had
    to do, by which the next step puts simulations side by side; no number depends on it. A
    simulation with more contacts than the solver holds, or with forces that do not settle, becomes
    not-a-number: it is counted and frozen like one that diverged.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        if reason := toolchain.unavailable():
            raise ValueError(f"backend 'fused' cannot run here: {reason}; use backend='native'")
        self.model = model
        self._platform = jax.default_backend()
        self._call = register(model, self._platform)

    def forward(self, state: PhysicsState, joint_range: jax.Array) -> jax.Array:
        """See `Physics.forward`."""
        control = jnp.zeros((state.qpos.shape[0], self.model.nu), jnp.float32)
        return self._run(state, control, joint_range, substeps=1)[1]

    def step(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array
    ) -> tuple[PhysicsState, jax.Array]:
        """See `Physics.step`."""
        return self._run(state, control, joint_range, SUBSTEPS)

    def _run(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array, substeps: int
    ) -> tuple[PhysicsState, jax.Array]:
        size, model = state.qpos.shape[0], self.model
        shapes = [
            jax.ShapeDtypeStruct((size, width), jnp.float32)
            for width in (model.nq, model.nv, model.nv, values_width(model))
        ]
        operands = [state.qpos, state.qvel, state.warmstart, control, joint_range]
        if self._platform == "gpu":
            operands.append(gpu.hardest_first(state.warmstart[:, 0]))
        call = jax.ffi.ffi_call(self._call, shapes)
        *after, sensors = call(*operands, substeps=np.int32(substeps))
        return PhysicsState(*after), sensors


def register(model: mujoco.MjModel, platform: str) -> str:
    """Return the name of the custom call for `model`, compiled for "cpu" or "gpu" on first use."""
    key = model_key(model)
    name = f"assistax_fused_{key}"
    with _REGISTERING:
        if (mark := f"{name} {platform}") not in _REGISTERED:
            backend = {"cpu": cpu, "gpu": gpu}[platform]
            backend.register(name, key, functools.partial(source, model))
            _REGISTERED.add(mark)
    return name


def source(model: mujoco.MjModel) -> str:
    """Return the text of the program of `model`."""
    return generate(model).source


def model_key(model: mujoco.MjModel) -> str:
    """Return the key of what a program's text is made from: the model and the generator."""
    size = mujoco.mj_sizeModel(model)
    data = np.empty(size, np.uint8)
    mujoco.mj_saveModel(model, None, data)
    here = Path(__file__).parents[1]
    files = sorted(path for path in here.iterdir() if path.suffix in (".py", ".h"))
    return compiled.key([data.tobytes(), *(path.read_bytes() for path in files)])
