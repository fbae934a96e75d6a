"""The environment: a task on a physics backend, batch first, inside jit and scan."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.humans import EnvParams, disability_params
from assistax_envs.models import build_model
from assistax_envs.models.care_scenes import STIFF_JOINTS
from assistax_envs.own_settings import check_generator, key_of, own_settings
from assistax_envs.physics import (
    SUBSTEPS,
    PhysicsState,
    check_scene,
    diverged,
    make_physics,
    resolve_backend,
)
from assistax_envs.registered import REGISTERED, TASK_CLASSES
from assistax_envs.tasks import speech
from assistax_envs.tasks.base import (
    ROBOT_JOINTS,
    Measures,
    Sensors,
    Task,
    check_terms,
    human_actuators,
    human_joints,
)
from assistax_envs.tremor import TremorFilter
from assistax_envs.versions import engine, playable_version

EPISODE_LENGTH = 1000  # control steps of 20 ms: always the full horizon
AT_END = 0.02  # rad from an end of its range, within which a joint counts as at its end


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class EnvState:
    """A batch of simulations; every leaf has axis N first."""

    physics: PhysicsState
    task: Any  # the task's own state
    obs: dict[str, jax.Array]  # "robot", "human", "global" -> [N, O]
    reward: jax.Array  # [N] of the step that led here
    terms: dict[str, jax.Array]  # [N] weighted reward terms; they sum to the reward
    measures: Measures
    terminated: jax.Array  # [N] bool: a protective stop ended the episode, of tasks that have it
    truncated: jax.Array  # [N] bool: this step was the episode's last
    step: jax.Array  # [N] int32 control steps since reset
    nonfinite: jax.Array  # [N] bool: physics diverged; frozen, earns 0 until the horizon
    tremor: jax.Array  # [N, 3, 2] filter state; 5 at the mouth
    # Of gentle tasks: the human's last word [N] int32, and steps [N] int32 that it is still heard.
    word: jax.Array | None
    heard: jax.Array | None
    params: EnvParams
    key: jax.Array  # [N] of the episode's noise


class Env:
    """A task on a physics backend. Make it with `make`, and never map it: it has a batch axis."""

    @own_settings()
    def __init__(
        self,
        task: str | type,
        backend: str = "auto",
        weights: dict[str, float] | None = None,
        version: int | None = None,
        **options: Any,
    ) -> None:
        of_task: Any = TASK_CLASSES[task] if isinstance(task, str) else task
        self.task = of_task.name
        self.backend = resolve_backend(backend)
        # 0, of no release, for a class from outside
        self.version = playable_version(task, version) if isinstance(task, str) else 0
        scene: str = of_task.scene
        check_scene(scene, self.backend)
        self.engine: dict[str, str] = engine(self.backend)
        self.episode_length = EPISODE_LENGTH
        self.model: mujoco.MjModel = build_model(scene)
        self._task: Task = of_task(self.model, weights, **options)
        self._sensors: Sensors = self._task.sensors
        self.stops: bool = self._task.stops
        self._physics = make_physics(self.model, self.backend)
        self._renderers: dict[tuple[int, int], Any] = {}  # by width and height
        self._tremor = TremorFilter(rate=1.0 / (SUBSTEPS * self.model.opt.timestep))
        driven = human_actuators(self.model)
        self._actuators = {
            "robot": np.array([self.model.actuator(name).id for name in ROBOT_JOINTS]),
            "human": np.array([self.model.actuator(name).id for name in driven]),
        }
        self._joints = {
            role: np.array([self.model.joint(name).qposadr[0] for name in names])
            for role, names in (("robot", ROBOT_JOINTS), ("human", human_joints(self.model)))
        }
        seat = [self.model.joint(name) for name in driven]
        self._seat = np.array([joint.id for joint in seat])
        self._seat_angles = np.array([joint.qposadr[0] for joint in seat])
        self._spared = REGISTERED[scene].spared
        # Joints that a disability stiffens, and their rest angles: those at which the scene starts.
        stiff = [self.model.joint(name) for name in STIFF_JOINTS[REGISTERED[scene].seat]]
        self._stiff = np.array([joint.id for joint in stiff])
        self._rest = self._task.pose.angle[[joint.qposadr[0] for joint in stiff]]
        self.term_names: tuple[str, ...] = tuple(self._task.weights)
        self.action_size: dict[str, int] = {role: len(ids) for role, ids in self._actuators.items()}
        keys = jax.random.split(key_of(0), 1)
        shapes = jax.eval_shape(self.reset, keys, disability_params(["d1"]))
        sizes = {name: obs.shape[-1] for name, obs in shapes.obs.items()}
        self.observation_size: dict[str, int] = sizes
        check_terms(self._task, shapes.terms)

    @own_settings()
    def reset(self, keys: jax.Array, params: EnvParams) -> EnvState:
        """Start episodes.

        Args:
            keys: [N] typed JAX keys of `GENERATOR`; the same key gives the same start on every
                backend.
            params: [N] impairments, for example from `disability_params`.
        """
        check_generator(keys)
        start_keys, episode_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        qpos, task = jax.vmap(self._task.reset)(start_keys, params)
        return self.begin(qpos, task, episode_keys, params)

    @own_settings()
    def begin(self, qpos: jax.Array, task: Any, keys: jax.Array, params: EnvParams) -> EnvState:
        """Start episodes from drawn starts.

        Args:
            qpos: [N, nq] joint positions, rad.
            task: the task's own state, leaves [N, ...].
            keys: [N] of the episodes' noise.
            params: [N] impairments.
        """
        n = qpos.shape[0]
        still = jnp.zeros((n, self.model.nv), jnp.float32)
        physics = PhysicsState(qpos, still, still)
        ranges = self._joint_range(params)
        readings = self._sensors.read(self._physics.forward(physics, ranges))
        _, obs, terms, measures = self._task.transition(task, readings)
        measures = self._touched(measures, physics, ranges)
        zero, false = jnp.zeros(n, jnp.float32), jnp.zeros(n, bool)
        silence = jnp.zeros(n, jnp.int32) if self.stops else None
        obs = speech.with_word(obs, silence, silence)
        return EnvState(
            physics=physics,
            task=task,
            obs=obs,
            reward=zero,
            terms=dict.fromkeys(terms, zero),
            measures=measures,
            terminated=false,
            truncated=false,
            step=jnp.zeros(n, jnp.int32),
            nonfinite=false,
            tremor=self._tremor.initial(n, self.action_size["human"]),
            word=silence,
            heard=silence,
            params=params,
            key=keys,
        )

    @own_settings()
    def step(self, state: EnvState, action: dict[str, jax.Array]) -> EnvState:
        """Advance by one control step of 20 ms.

        Args:
            state: [N] simulations.
            action: "robot" [N, 7] and "human" [N, 3], at the mouth [N, 5], in [-1, 1] (clipped):
                shares of the torque limits. In gentle tasks "word" [N] int32 may be given: codes of
                `assistax_envs.preferences`, 0 for silence.

        Returns:
            The next state. A simulation whose physics diverged keeps its last finite state and
            earns 0. Reset a simulation that a protective stop ended: its later steps do not count.
        """
        word, heard = speech.heard(state, action.get("word"))
        action = {role: jnp.asarray(action[role], jnp.float32) for role in self.action_size}
        tremor, shake = self._tremor.shake(state.tremor, state.key, state.step, state.params.tremor)
        control = self._control(state.params, action, shake)
        ranges = self._joint_range(state.params)
        physics, values = self._physics.step(state.physics, control, ranges)
        task, obs, terms, measures = self._task.transition(state.task, self._sensors.read(values))
        measures = self._touched(measures, physics, ranges)
        obs = speech.with_word(obs, word, heard)
        nonfinite = state.nonfinite | diverged(physics, values, control)
        physics, task, obs, measures = select(
            nonfinite,
            (state.physics, state.task, state.obs, state.measures),
            (physics, task, obs, measures),
        )
        weighted = {
            name: jnp.where(nonfinite, 0.0, w * terms[name])
            for name, w in self._task.weights.items()
        }
        step = state.step + 1
        return dataclasses.replace(
            state,
            physics=physics,
            task=task,
            obs=obs,
            reward=sum(weighted.values(), start=jnp.zeros_like(state.reward)),
            terms=weighted,
            measures=measures,
            terminated=measures.violated if self.stops else state.terminated,
            truncated=step >= self.episode_length,
            step=step,
            nonfinite=nonfinite,
            tremor=tremor,
            word=word,
            heard=heard,
        )

    def _touched(self, measures: Measures, physics: PhysicsState, ranges: jax.Array) -> Measures:
        """Set `at_end` of a task's measures: touched with a driven joint near its limit."""
        if not self.stops:
            return measures
        angles, ends = physics.qpos[:, self._seat_angles], ranges[:, self._seat]
        at_end = (angles < ends[..., 0] + AT_END) | (angles > ends[..., 1] - AT_END)
        return dataclasses.replace(measures, at_end=at_end.any(axis=1) & (measures.force > 0.0))

    @own_settings()
    def joint_positions(self, state: EnvState) -> dict[str, jax.Array]:
        """Return the joint angles of each role, rad: "robot" [N, 7] and "human" [N, 9]."""
        return {role: state.physics.qpos[:, addresses] for role, addresses in self._joints.items()}

    @own_settings()
    def marks(self, state: EnvState) -> dict[str, jax.Array]:
        """Return the places that pictures mark, m: "tool" [N, 1, 3] and targets [N, K, 3]."""
        ranges = self._joint_range(state.params)
        readings = self._sensors.read(self._physics.forward(state.physics, ranges))
        tool = {"tool": readings.tool_position[:, None]}
        return tool | self._task.targets(state.task, readings)

    def render(
        self,
        state: EnvState,
        index: int = 0,
        camera: str | None = None,
        width: int = 640,
        height: int = 480,
        caption: tuple[str, ...] = (),
    ) -> np.ndarray:
        """Draw simulation `index` as uint8 [height, width, 3], with or without a GPU or a display.

        Args:
            state: [N] simulations.
            index: which of them.
            camera: a camera of the scene, or "close"; the scene's first one if not given.
            width: pixels.
            height: pixels.
            caption: lines to write below. The last names the human: humans of the same name look
                the same.

        Raises:
            ValueError: there is no such simulation or camera, or this machine lacks EGL and OSMesa.
        """
        from assistax_envs.drawing.render import Renderer

        size = width, height
        if size not in self._renderers:
            self._renderers[size] = Renderer(self._task, width, height)
        return self._renderers[size].frame(state, index, camera, caption)

    def shown(self, states: Sequence[EnvState]) -> dict[str, np.ndarray]:
        """Return the columns [T, ...] that players draw T states of one simulation from."""
        from assistax_envs.drawing.render import shown

        return shown(self._task, self.model, states)

    def close(self) -> None:
        """Free the OpenGL contexts of `render`; call it in the thread that drew."""
        while self._renderers:
            self._renderers.popitem()[1].close()

    def _control(
        self, params: EnvParams, action: dict[str, jax.Array], shake: jax.Array
    ) -> jax.Array:
        """Return the controls [N, nu]: the human's have its strength and its tremor."""
        strength = self._left(params.strength)
        human = jnp.clip(action["human"], -1.0, 1.0) * strength[:, None] + shake
        control = jnp.zeros((human.shape[0], self.model.nu), jnp.float32)
        control = control.at[:, self._actuators["robot"]].set(jnp.clip(action["robot"], -1.0, 1.0))
        return control.at[:, self._actuators["human"]].set(jnp.clip(human, -1.0, 1.0))

    def _left(self, share: jax.Array) -> jax.Array:
        """Return the share [N] of strength or range that is left in this scene.

        Scenes that spare no share return it as it is: the paper's tasks keep their bits.
        """
        return 1.0 - (1.0 - self._spared) * (1.0 - share) if self._spared else share

    def _joint_range(self, params: EnvParams) -> jax.Array:
        """Return joint limits [N, njnt, 2], narrowed about rest for the impaired joints."""
        full, left = jnp.asarray(self.model.jnt_range, jnp.float32), self._left(params.elbow_range)
        rest = self._rest[:, None]
        stiff = rest[None] + left[:, None, None] * (full[self._stiff] - rest)[None]
        return (
            jnp.broadcast_to(full, (params.elbow_range.shape[0], *full.shape))
            .at[:, self._stiff]
            .set(stiff)
        )


def make(
    task: str | type,
    backend: str = "auto",
    weights: dict[str, float] | None = None,
    version: int | None = None,
    **options: Any,
) -> Env:
    """Make the environment of `task`.

    Args:
        task: one of `TASKS`, or a class of your own whose `scene` names the task of its scene.
        backend: "fused" (CPUs and NVIDIA GPUs), "native" (MuJoCo on CPU threads), "mjx" (XLA),
            "mjx-warp" (NVIDIA GPUs), or "auto": the fastest one here.
        weights: reward weights by term that replace those of Table 5.
        version: of the environment; the installed one, `VERSIONS[task]`, is the only one allowed.
        options: of the task; arm assist has `rotation`, "printed" (default) or "aligned".

    Raises:
        ValueError: the task, its version, the backend or a weight's name is unknown, or the backend
            cannot run here.
    """
    if isinstance(task, str) and task not in REGISTERED:
        raise ValueError(f"task is {task!r}; allowed are {', '.join(REGISTERED)}")
    return Env(task, backend, weights, version, **options)


def select(mask: jax.Array, on_true: Any, on_false: Any) -> Any:
    """Choose whole simulations.

    Leafwise `where` with `mask` [N] over the first axis of two like pytrees.
    """

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b)

    return jax.tree.map(choose, on_true, on_false)
