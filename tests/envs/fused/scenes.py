"""Models and states for the tests of the fused engine, and MuJoCo's C engine as their oracle."""

import copy
import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs import TASKS as TASKS
from assistax_envs import compiled
from assistax_envs.models import build_model
from assistax_envs.physics.base import values_width
from assistax_envs.physics.fused import generate
from assistax_envs.physics.fused.runtime import cpu
from assistax_envs.versions import CARE_TASKS
from tests.envs.base_scenes import BASES

ELBOW = "human_right_elbow"
DEEP = 0.025  # m; the thinnest two capsules that meet have their axes 0.041 apart
BETWEEN_LIPS = 0.006  # m; a lip and a spoon have them 0.012 apart
scene = functools.cache(build_model)


def converged(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of the model whose solver runs until nothing changes."""
    model = copy.copy(model)
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    model.opt.tolerance, model.opt.ls_tolerance = 1e-12, 1e-6
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


def deep(model: mujoco.MjModel) -> float:
    """Return the depth, in m, beyond which a contact's direction is anybody's guess."""
    names = {model.joint(i).name for i in range(model.njnt)}
    return BETWEEN_LIPS if "human_jaw" in names else DEEP


class States:
    """Angles, velocities and controls [N, ...], rounded to single precision."""

    def __init__(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        self.qpos, self.qvel, self.ctrl = (np.asarray(x, np.float32) for x in (qpos, qvel, ctrl))

    def __len__(self) -> int:
        return len(self.qpos)

    def __getitem__(self, index) -> "States":
        return States(self.qpos[index], self.qvel[index], self.ctrl[index])


def random_states(model: mujoco.MjModel, n: int, seed: int, beyond: float = 0.01) -> States:
    """Draw angles over the joints' ranges and `beyond` that share of them, and full torques.

    Returns fewer than `n`: without those in which bodies are so deep in each other that the axes of
    capsules cross, where a contact's direction is anybody's guess.
    """
    rng = np.random.default_rng(seed)
    low, high = model.jnt_range.T
    share = rng.uniform(-beyond, 1 + beyond, (n, model.nq))
    states = States(
        low + (high - low) * share,
        rng.normal(size=(n, model.nv)),
        rng.uniform(-1, 1, (n, model.nu)),
    )
    return states[np.array([deepest(model, qpos) < deep(model) for qpos in states.qpos])]


def deepest(model: mujoco.MjModel, qpos: np.ndarray) -> float:
    """Return the depth of the deepest contact, in m."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return -min((contact.dist for contact in data.contact), default=0.0)


@functools.cache
def touching_states(task: str, each: int = 6) -> States:
    """Return states in which each of the scene's pairs in turn touches, by up to 8 mm."""
    model, rng = scene(task), np.random.default_rng(11)
    data, touching = mujoco.MjData(model), []
    for pair in range(model.npair):
        count = len(touching) + each
        while len(touching) < count:
            if (qpos := _touching(model, data, pair, rng)) is not None:
                touching.append(qpos)
    n = len(touching)
    return States(
        np.array(touching), rng.normal(size=(n, model.nv)), rng.uniform(-1, 1, (n, model.nu))
    )


def _touching(model, data, pair: int, rng: np.random.Generator) -> np.ndarray | None:
    """Move from random angles towards the pair's touch by random steps; None if others collide."""
    # Not to the very limit: whether that is passed depends on rounding alone.
    low, high = model.jnt_range.T + np.array([[1e-3], [-1e-3]])
    geoms = int(model.pair_geom1[pair]), int(model.pair_geom2[pair])
    depth = rng.uniform(1e-4, 8e-3)

    def miss(qpos: np.ndarray) -> float:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        return abs(mujoco.mj_geomDistance(model, data, *geoms, 5.0, None) + depth)

    best = rng.uniform(low, high)
    least = miss(best)
    for _ in range(600):
        trial = np.clip(best + rng.normal(size=model.nq) * min(0.2, 2 * least), low, high)
        if (missed := miss(trial)) < least:
            best, least = trial, missed
        if least < 5e-5:
            break
    miss(best)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    touches = any(set(contact.geom) == set(geoms) for contact in data.contact)
    return best if touches and deepest(model, best) < deep(model) else None


def resting_states(task: str, n: int) -> States:
    """Return states in which all has come to rest: bodies lie and lean, and joints hang."""
    model, drawn = converged(scene(task)), team_states(task)[0][np.arange(n)]  # a copy
    data = mujoco.MjData(model)
    for i in range(n):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = drawn.qpos[i]
        mujoco.mj_step(model, data, 400)
        drawn.qpos[i], drawn.qvel[i], drawn.ctrl[i] = data.qpos, data.qvel, 0.0
    return drawn


@functools.cache
def team_states(task: str) -> tuple[States, np.ndarray]:
    """Return states of trained teams, shuffled, and the joints' ranges [N, njnt, 2] in each.

    Of a gentle task's scene, the states of the paper's task from whose scene it is made.
    """
    base, model = BASES.get(task, task), scene(task)
    with np.load(Path(__file__).with_name("team_states.npz")) as file:
        arrays = {k.removeprefix(f"{base}_"): v for k, v in file.items() if k.startswith(base)}
    if task in CARE_TASKS:  # of a scripted pair
        with np.load(Path(__file__).with_name(f"{task}_states.npz")) as file:
            arrays = dict(file)
    ranges = np.tile(model.jnt_range.astype(np.float32), (len(arrays["qpos"]), 1, 1))
    if "elbow" in arrays:
        ranges[:, model.joint(ELBOW).id] = arrays["elbow"]
    order = np.random.default_rng(0).permutation(len(ranges))
    return States(*(arrays[name] for name in ("qpos", "qvel", "ctrl")))[order], ranges[order]


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
        self,
        model: mujoco.MjModel,
        lanes: int = 8,
        features: tuple[str, ...] = cpu.NATIVE,
        contraction: str = "off",
    ) -> None:
        program = generate(model)
        source = program.source.replace("contract(off)", f"contract({contraction})")
        text = source
        key = compiled.key([text.encode(), str(lanes).encode(), *(x.encode() for x in features)])
        self._name = f"test_{key}"
        self._widths = program.nq, program.nv, program.nv, values_width(model)
        self._range, self._sensors = model.jnt_range, model.nsensordata
        cpu.register(self._name, key, lambda: text, lanes, features)

    def __call__(
        self, states: States, substeps: int = 1, ranges: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return angles, velocities and sensors after `substeps`."""
        n = len(states)
        ranges = np.broadcast_to(self._range if ranges is None else ranges, (n, *self._range.shape))
        shapes = [jax.ShapeDtypeStruct((n, width), jnp.float32) for width in self._widths]
        call = jax.ffi.ffi_call(self._name, shapes)
        still, ranges = np.zeros_like(states.qvel), np.asarray(ranges, np.float32)
        values = states.qpos, states.qvel, still, states.ctrl, ranges
        qpos, qvel, _, sensors = call(*map(jnp.asarray, values), substeps=np.int32(substeps))
        return np.asarray(qpos), np.asarray(qvel), np.asarray(sensors)[:, : self._sensors]


@functools.cache
def engine(task: str, lanes: int = 8) -> Engine:
    return Engine(scene(task), lanes)


def relative_error(got: np.ndarray, want: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the error of each velocity change [N], relative to its size."""
    return np.linalg.norm(got - want, axis=1) / np.linalg.norm(want - before, axis=1)


def sensitivity(
    model: mujoco.MjModel,
    states: States,
    substeps: int = 1,
    ranges: np.ndarray | None = None,
    shifts: np.ndarray | None = None,
) -> np.ndarray:
    """Return how much velocities [N] differ when angles do by 1e-7 rad: single precision's step.

    The largest of four directions, or of `shifts` [K, N, Q] rad; large where a touch begins or
    ends, and in stiff contacts.
    """
    _, want, _ = oracle(model, states, substeps, ranges)
    if shifts is None:
        signs = np.random.default_rng(12).choice([-1.0, 1.0], (4, 1, model.nq))
        shifts = 1e-7 * np.concatenate([signs[:2], -signs[:2]])
    moved = []
    for shift in shifts:
        other = copy.copy(states)
        other.qpos = states.qpos.astype(float) + shift
        moved.append(np.linalg.norm(oracle(model, other, substeps, ranges)[1] - want, axis=1))
    return np.max(moved, axis=0)
