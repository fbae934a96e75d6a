"""MuJoCo's JAX engine, in its XLA and its Warp implementation."""

import copy
import os
import warnings

import jax
import jax.numpy as jnp
import mujoco

from assistax_envs.physics.base import SUBSTEPS, PhysicsState
from assistax_envs.stdout import stdout_is_data

# Measured with JAX 0.10.2 on 2 cores: one control step of 4 simulations takes 10 s without the
# flag, 2 ms with it. XLA of JAX 0.11.1 needs no flag, and aborts on this one.
CPU_FLAG = "--xla_cpu_use_fusion_emitters=false"
# Warp's contact buffer; a scene's geoms rarely touch in more places at once.
CONTACTS_PER_SIMULATION = 12
CONSTRAINTS_PER_SIMULATION = 72  # Warp's constraint rows: contacts take 4 each, joint limits 1
# Warp's buffer of each contact sensor; a pair of our geoms touches in 2 places at most.
CONTACTS_PER_SENSOR = 4


class MjxPhysics:
    """`mjx.step` mapped over the batch, by implementation "jax" (XLA) or "warp" (NVIDIA GPUs)."""

    def __init__(self, model: mujoco.MjModel, implementation: str = "jax") -> None:
        with stdout_is_data():  # mjx and warp print when imported
            from mujoco import mjx

        if implementation == "warp":
            _check_warp()
        elif _needs_cpu_flag():
            warnings.warn(
                "backend 'mjx' on a CPU runs thousands of times slower than it can, because XLA of "
                "this JAX fuses the kinematic chain into recomputation; upgrade to JAX 0.11.1 or "
                f"newer, start Python with XLA_FLAGS={CPU_FLAG}, or use backend='native'",
                stacklevel=4,
            )
        self.model = model
        self._mjx = mjx
        self._implementation = implementation
        self._mjx_model = self._put(model)
        # Only the last substep's sensor values are read. Warp skips the kernels of the others. XLA
        # computes them, since skipping would compile the step twice.
        self._blind_model = self._put(_without_sensors(model)) if implementation == "warp" else None

    def forward(self, state: PhysicsState, joint_range: jax.Array) -> jax.Array:
        """See `Physics.forward`."""
        template = self._template(state.qpos.shape[0])

        def one(state: PhysicsState, joint_range: jax.Array) -> jax.Array:
            data = template.replace(
                qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.warmstart
            )
            return self._mjx.forward(_limited(self._mjx_model, joint_range), data).sensordata

        with jax.numpy_rank_promotion("allow"):  # MJX promotes ranks; callers may be strict
            return jax.vmap(one)(state, joint_range)

    def step(
        self, state: PhysicsState, control: jax.Array, joint_range: jax.Array
    ) -> tuple[PhysicsState, jax.Array]:
        """See `Physics.step`."""
        template = self._template(state.qpos.shape[0])

        def one(
            state: PhysicsState, control: jax.Array, joint_range: jax.Array
        ) -> tuple[PhysicsState, jax.Array]:
            data = template.replace(
                qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.warmstart, ctrl=control
            )
            if self._blind_model is None:
                data = self._advance(self._mjx_model, data, joint_range, SUBSTEPS)
            else:
                data = self._advance(self._blind_model, data, joint_range, SUBSTEPS - 1)
                data = self._advance(self._mjx_model, data, joint_range, 1)
            return PhysicsState(data.qpos, data.qvel, data.qacc_warmstart), data.sensordata

        with jax.numpy_rank_promotion("allow"):
            return jax.vmap(one)(state, control, joint_range)

    def _put(self, model: mujoco.MjModel):
        """Return the MJX model of a model."""
        mjx_model = self._mjx.put_model(model, impl=self._implementation)
        return _tuned(mjx_model) if self._implementation == "warp" else mjx_model

    def _advance(self, mjx_model, data, joint_range: jax.Array, substeps: int):
        """Return the data after some substeps."""
        limited = _limited(mjx_model, joint_range)
        return jax.lax.scan(
            lambda data, _: (self._mjx.step(limited, data), None), data, length=substeps
        )[0]

    def _template(self, size: int):
        """Return the data that a control step starts from; Warp's buffers hold the whole batch."""
        if self._implementation == "warp":
            return self._mjx.make_data(
                self.model,
                impl="warp",
                naconmax=CONTACTS_PER_SIMULATION * size,
                njmax=CONSTRAINTS_PER_SIMULATION,
            )
        return jax.tree.map(jnp.asarray, self._mjx.make_data(self.model, impl="jax"))


def _needs_cpu_flag() -> bool:
    """Return whether this JAX needs `CPU_FLAG` on this machine and lacks it."""
    affected = jax.default_backend() == "cpu" and jax.__version_info__ < (0, 11, 1)
    return affected and CPU_FLAG not in os.environ.get("XLA_FLAGS", "")


def _check_warp() -> None:
    """Refuse a machine without Warp or without an NVIDIA GPU."""
    try:
        with stdout_is_data():
            import warp

            warp.config.quiet = True
            warp.init()
    except ImportError as error:
        raise ValueError(
            "backend 'mjx-warp' needs the package warp-lang, which is not installed; "
            "install it with: pip install warp-lang, or use backend='native'"
        ) from error
    if not any(device.platform == "gpu" for device in jax.devices()):
        raise ValueError(
            "backend 'mjx-warp' needs an NVIDIA GPU that JAX sees; JAX has only "
            f"{jax.devices()[0].platform}; install 'assistax-zoo[cuda12]', or use backend='native'"
        )


def _limited(mjx_model, joint_range: jax.Array):
    """Return an MJX model with other joint ranges."""
    return mjx_model.tree_replace({"jnt_range": joint_range})


def _without_sensors(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model whose sensors are off."""
    blind = copy.copy(model)
    blind.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    return blind


def _tuned(mjx_model):
    """Return an MJX model without Warp's warnings of a bounded solver, which is intended.

    Warnings of overflowing buffers stay. The buffer of contact sensors, cleared every step, is made
    smaller.
    """
    from mujoco.mjx.third_party import mujoco_warp

    private = mjx_model.opt._impl
    bounded = mujoco_warp.OverflowType.ITERATIONS | mujoco_warp.OverflowType.LS_ITERATIONS
    private = private.replace(
        warn_overflow=private.warn_overflow & ~int(bounded),
        contact_sensor_maxmatch=CONTACTS_PER_SENSOR,
    )
    return mjx_model.replace(opt=mjx_model.opt.replace(_impl=private))
