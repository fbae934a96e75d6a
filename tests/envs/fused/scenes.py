"""Models and states for the tests of the fused engine, and MuJoCo's C engine as their oracle."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.models import build_model
from assistax_envs.physics.fused import generate
from assistax_envs.physics.fused.runtime import cache, cpu

TASKS = "scratch", "bed_bath", "arm_assist"
scene = functools.cache(build_model)


def converged(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of the model whose solver runs until nothing changes."""
    copy = mujoco.MjModel.from_xml_string("<mujoco/>") if model is None else _copy(model)
    copy.opt.iterations, copy.opt.ls_iterations = 100, 50
    copy.opt.tolerance, copy.opt.ls_tolerance = 1e-12, 1e-6
    copy.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return copy


def _copy(model: mujoco.MjModel) -> mujoco.MjModel:
    import copy

    return copy.copy(model)


class States:
    """Angles, velocities and controls [N, ...], rounded to single precision."""

    def __init__(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        self.qpos, self.qvel, self.ctrl = (np.asarray(x, np.float32) for x in (qpos, qvel, ctrl))

    def __len__(self) -> int:
        return len(self.qpos)

    def __getitem__(self, index) -> "States":
        return States(self.qpos[index], self.qvel[index], self.ctrl[index])


def random_states(model: mujoco.MjModel, n: int, seed: int, beyond: float = 0.01) -> States:
    """Draw angles over the joints' ranges and `beyond` that share of them, and full torques."""
    rng = np.random.default_rng(seed)
    low, high = model.jnt_range.T
    share = rng.uniform(-beyond, 1 + beyond, (n, model.nq))
    return States(
        low + (high - low) * share,
        rng.normal(size=(n, model.nv)),
        rng.uniform(-1, 1, (n, model.nu)),
    )


def touching_states(model: mujoco.MjModel, n: int, seed: int) -> States:
    """Draw states until `n` have contacts, none of them deep."""
    found: list[np.ndarray] = []
    data, states = mujoco.MjData(model), random_states(model, 40 * n, seed)
    for i in range(len(states)):
        data.qpos[:] = states.qpos[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        if 0 < data.ncon <= 5 and data.contact.dist.min() > -0.03:
            found.append(i)
    assert len(found) >= n, len(found)
    return states[np.array(found[:n])]


def oracle(
    model: mujoco.MjModel, states: States, substeps: int = 1, ranges: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return angles, velocities and sensors after `substeps` of converged MuJoCo."""
    model = converged(model)
    data, results = mujoco.MjData(model), []
    for i in range(len(states)):
        mujoco.mj_resetData(model, data)
        if ranges is not None:
            model.jnt_range[:] = ranges[i]
        data.qpos[:], data.qvel[:] = states.qpos[i], states.qvel[i]
        data.ctrl[:] = states.ctrl[i]
        mujoco.mj_step(model, data, substeps)
        results.append((data.qpos.copy(), data.qvel.copy(), data.sensordata.copy()))
    return tuple(map(np.array, zip(*results, strict=True)))


class Engine:
    """The generated program of a model, compiled by the runtime for one number of lanes."""

    def __init__(
        self, model: mujoco.MjModel, lanes: int = 8, features: tuple[str, ...] = cpu.NATIVE
    ) -> None:
        program = generate(model)
        text = program.source + f"#define NSENS {program.nsensordata}\n"
        key = cache.key([text.encode(), str(lanes).encode(), *(x.encode() for x in features)])
        self._name = f"test_{key}"
        self._widths = program.nq, program.nv, program.nsensordata
        self._range = model.jnt_range
        cpu.register(self._name, key, lambda: text, lanes, features)

    def __call__(
        self, states: States, substeps: int = 1, ranges: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return angles, velocities and sensors after `substeps`."""
        n = len(states)
        ranges = np.broadcast_to(self._range if ranges is None else ranges, (n, *self._range.shape))
        shapes = [jax.ShapeDtypeStruct((n, width), jnp.float32) for width in self._widths]
        call = jax.ffi.ffi_call(self._name, shapes)
        values = states.qpos, states.qvel, states.ctrl, np.asarray(ranges, np.float32)
        return tuple(map(np.asarray, call(*map(jnp.asarray, values), substeps=np.int32(substeps))))


@functools.cache
def engine(task: str, lanes: int = 8) -> Engine:
    return Engine(scene(task), lanes)


def relative_error(got: np.ndarray, want: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the error of each velocity change [N], relative to its size."""
    return np.linalg.norm(got - want, axis=1) / np.linalg.norm(want - before, axis=1)
