"""Gymnasium's interfaces: the robot is the agent, and a partner sits in the human's seat.

`AssistaxEnv` is one simulation, `AssistaxVectorEnv` are hundreds at once.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from assistax_envs.adapters.batch import OBSERVATION_BOUND, Batch, HostBatch, checked_seed
from assistax_envs.adapters.partners import Idle, Partners
from assistax_envs.adapters.simulation import INSTALL, Simulation
from assistax_envs.disability import Disability
from assistax_envs.own_settings import own_settings
from assistax_envs.versions import VERSIONS

try:
    import gymnasium
except ImportError as error:
    raise ImportError(f"this adapter needs the package gymnasium; {INSTALL}") from error

# Function from an observation [O] float32 to an action [3] in [-1, 1]; it may have `reset()`.
Partner = Callable[[np.ndarray], Any]


class AssistaxEnv(gymnasium.Env):
    """A robot's task with a partner that is part of the environment.

    An episode is truncated at its 1000th step.

    The partner is any callable from the human's observation to its action. If it has a method
    `reset`, this is called at episode starts. If it has `word`, this is called after each action
    and returns what the human says, a code of `preferences.WORDS`. If it has `humans`, these are
    its own body and wishes. Without a partner the human exerts no torque.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 - Gymnasium's own type

    def __init__(
        self,
        task: str,
        partner: Partner | None = None,
        disability: str | Disability | None = None,
        backend: str = "native",
        weights: dict[str, float] | None = None,
        render_mode: str | None = None,
        camera: str | None = None,
        version: int | None = None,
    ) -> None:
        """Make the environment.

        Args:
            task: one of `assistax_envs.TASKS`.
            partner: policy of the human.
            disability: the human's; by default the partner's `setting`, or "d1" if it has none.
            backend: see `assistax_envs.make`.
            weights: reward weights that replace those of Table 5.
            render_mode: None or "rgb_array".
            camera: camera of the pictures; the scene's first if not given.
            version: version of the environment; by default the partner's `env_version`, or the
                newest if it has none.
        """
        if partner is not None and not callable(partner):
            raise TypeError(
                f"partner is a {type(partner).__name__}; expected a callable from observation to "
                "action"
            )
        self.render_mode = render_mode
        self.partner = partner
        humans = getattr(partner, "humans", None)
        if humans is not None and disability:
            raise ValueError("the partner is a person with its own body; leave disability out")
        impairment = disability or getattr(partner, "setting", None) or "d1"
        version = version or getattr(partner, "env_version", None)
        self._simulation = Simulation(
            task, impairment, backend, weights, render_mode, camera, version, humans
        )
        env = self._simulation.env
        self.observation_space = bounded_box(OBSERVATION_BOUND, env.observation_size["robot"])
        self.action_space = bounded_box(1.0, env.action_size["robot"])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; return the robot's observation and info.

        A seed makes this episode and later ones reproducible. `options` are not used.
        """
        super().reset(seed=checked_seed(seed))
        self._simulation.reset(self.np_random)
        if callable(restart := getattr(self.partner, "reset", None)):
            restart()
        return self._simulation.observation("robot"), self._simulation.info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by 20 ms; the partner acts on its observation of the same moment.

        Actions are clipped to [-1, 1].
        """
        if self.partner is None:
            answer = np.zeros(self._simulation.env.action_size["human"], np.float32)
        else:
            answer = self.partner(self._simulation.observation("human"))
        said = getattr(self.partner, "word", None)
        words = {"word": int(said())} if callable(said) else {}
        self._simulation.step({"robot": action, "human": answer, **words})
        observation, info = self._simulation.observation("robot"), self._simulation.info()
        return observation, *self._simulation.outcome(), info

    def render(self) -> np.ndarray | None:
        """See `Simulation.render`."""
        return self._simulation.render()


class AssistaxVectorEnv(gymnasium.vector.VectorEnv):
    """Hundreds of simulations of a task in one program; their partners sit inside.

    Each simulation gets a new partner every 1000 steps. All simulations are truncated at the same
    step, the 1000th. A protective stop of the gentle tasks ends an episode before; the next one
    lasts until that step, with the same partner. A step that ends an episode returns the next
    episode's first observation (SAME_STEP): no step is spent on a reset, which learners would have
    to mask. `info["final_obs"]` [N, O] holds the ended episodes' last observations, from which the
    value at the time limit is computed.

    `info` holds force [N], distance [m], success, nonfinite, reward terms and, in gentle tasks,
    violations, [N] each.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's own type
        "render_modes": [],
        "autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        task: str,
        num_envs: int = 512,
        partners: Partners | None = None,
        disability: str | Disability | Sequence[str | Disability] = "d1",
        backend: str = "auto",
        weights: dict[str, float] | None = None,
        arrays: str = "numpy",
        version: int | None = None,
    ) -> None:
        """Make the environment.

        Args:
            task: One of `assistax_envs.TASKS`.
            num_envs: N, simulations.
            partners: Partners in the human's seats, such as `adapters.partners.Persons`; by
                default idle humans.
            disability: Setting of idle humans; of several, each episode draws one.
            backend: See `assistax_envs.make`.
            weights: Reward weights that replace those of the task.
            arrays: Type of returned arrays: "numpy", or "jax", which `torch.from_dlpack` takes
                without a copy and which must not be changed. Actions may be either.
            version: Version of the environment; the newest if not given.

        Raises:
            ValueError: An argument is not allowed.
        """
        batch = Batch(task, partners or Idle(disability), num_envs, backend, weights, version)
        self._host = HostBatch(batch, arrays)
        self.num_envs, env = num_envs, batch.env
        self.single_observation_space = bounded_box(
            OBSERVATION_BOUND, env.observation_size["robot"]
        )
        self.single_action_space = bounded_box(1.0, env.action_size["robot"])
        batched = gymnasium.vector.utils.batch_space
        self.observation_space = batched(self.single_observation_space, num_envs)
        self.action_space = batched(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every simulation; return the robots' observations and an empty info.

        One seed for all makes this episode and later ones reproducible. `options` are not used.

        Raises:
            ValueError: Only some simulations are to be reset, or each from a seed of its own.
        """
        if options and "reset_mask" in options:
            raise ValueError(
                "options has a reset_mask, but all simulations begin together; leave it out"
            )
        super().reset(seed=checked_seed(seed))
        return self._host.reset(self.np_random)["robot"], {}

    @own_settings()
    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Advance by 20 ms; actions [N, A] are clipped to [-1, 1]."""
        step, ended = self._host.step(self.np_random, {"robot": actions})
        outcome = step.obs["robot"], step.reward, step.terminated, step.truncated, step.info
        *values, info = self._host.out(outcome)
        final: dict[str, Any] = {}
        if ended.any():
            final = {"final_obs": self._host.out(step.final_obs["robot"]), "final_info": info}
        running = {} if ended.all() else _masked(info, self._mask(~ended))
        return *values, running | _masked(final, self._mask(ended))

    def _mask(self, which: np.ndarray) -> Any:
        return self._host.out(jax.numpy.asarray(which))

    def partner_names(self) -> list[str]:
        """Return the name of each simulation's partner in this episode.

        Raises:
            ValueError: No episode was started yet.
        """
        return self._host.partner_names()


def bounded_box(bound: float, size: int) -> gymnasium.spaces.Box:
    """Return the space of `size` numbers between -bound and bound."""
    return gymnasium.spaces.Box(-bound, bound, (size,), np.float32)


def _masked(info: dict[str, Any], mask: Any) -> dict[str, Any]:
    """Return an info with Gymnasium's mask beside each entry: the simulations that have it."""
    return {
        key: value
        for name, entry in info.items()
        for key, value in (
            (name, _masked(entry, mask) if isinstance(entry, dict) else entry),
            (f"_{name}", mask),
        )
    }


def register() -> tuple[str, ...]:
    """Register every task as `assistax/TASK-vVERSION`; return these ids.

    `gymnasium.make` then makes one simulation, and `gymnasium.make_vec` many at once.
    """
    ids = {task: f"assistax/{task}-v{version}" for task, version in VERSIONS.items()}
    for task, name in ids.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"{__name__}:AssistaxEnv",
                vector_entry_point=f"{__name__}:AssistaxVectorEnv",
                kwargs={"task": task},
            )
    return tuple(ids.values())
