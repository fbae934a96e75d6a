"""PettingZoo's `ParallelEnv`: robot and human as its two agents.

`AssistaxParallelEnv` is one simulation, `AssistaxParallelVectorEnv` are hundreds at once.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from assistax_envs.adapters.batch import OBSERVATION_BOUND, Batch, HostBatch, checked_seed
from assistax_envs.adapters.partners import Idle, Partners
from assistax_envs.adapters.simulation import INSTALL, Simulation
from assistax_envs.disability import Disability

try:
    import gymnasium
    import pettingzoo
except ImportError as error:
    raise ImportError(f"this adapter needs the package pettingzoo; {INSTALL}") from error

ROLES = ("robot", "human")


class AssistaxParallelEnv(pettingzoo.ParallelEnv):
    """Task for two agents, "robot" and "human", which share the reward.

    An episode is truncated at its 1000th step.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's own type
        "name": "assistax",
        "render_modes": ["rgb_array"],
        "is_parallelizable": True,
        "render_fps": 50,
    }

    def __init__(
        self,
        task: str,
        disability: str | Disability = "d1",
        backend: str = "native",
        weights: dict[str, float] | None = None,
        render_mode: str | None = None,
        camera: str | None = None,
    ) -> None:
        """See `assistax_envs.make`.

        `disability` is the human's, `render_mode` is None or "rgb_array".
        """
        self.render_mode = render_mode
        self.possible_agents = list(ROLES)
        self.agents: list[str] = []
        self._simulation = Simulation(task, disability, backend, weights, render_mode, camera)
        self._rng = np.random.default_rng()
        env = self._simulation.env
        self.observation_spaces = {
            role: _box(OBSERVATION_BOUND, env.observation_size[role]) for role in ROLES
        }
        self.action_spaces = {role: _box(1.0, env.action_size[role]) for role in ROLES}
        self.state_space = _box(OBSERVATION_BOUND, env.observation_size["global"])

    def observation_space(self, agent: str) -> gymnasium.Space:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Start an episode; return observations and infos by agent.

        A seed makes this episode and later ones reproducible. `options` are not used.
        """
        if checked_seed(seed) is not None:
            self._rng = np.random.default_rng(seed)
        self._simulation.reset(self._rng)
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Advance by 20 ms; return the agents' dictionaries, which are empty if no agent is left.

        Actions are clipped to [-1, 1].
        """
        if not self.agents:
            return {}, {}, {}, {}, {}
        self._simulation.step(actions)
        reward, terminated, truncated = self._simulation.outcome()
        if terminated or truncated:
            self.agents = []
        return (
            self._observations(),
            dict.fromkeys(ROLES, reward),
            dict.fromkeys(ROLES, terminated),
            dict.fromkeys(ROLES, truncated),
            self._infos(),
        )

    def state(self) -> np.ndarray:
        """Return the observation for central critics, `global` [O]."""
        return self._simulation.observation("global")

    def render(self) -> np.ndarray | None:
        """See `Simulation.render`."""
        return self._simulation.render()

    def close(self) -> None:
        """Do nothing: there is no window."""

    def _observations(self) -> dict[str, np.ndarray]:
        return {role: self._simulation.observation(role) for role in ROLES}

    def _infos(self) -> dict[str, dict[str, Any]]:
        return {role: self._simulation.info() for role in ROLES}


class AssistaxParallelVectorEnv(pettingzoo.ParallelEnv):
    """Hundreds of simulations of a task in one program, for both agents or the robot alone.

    The dictionaries are those of `ParallelEnv`, and every value in them has an axis N of
    simulations in front: observations [N, O], rewards, terminated and truncated [N]. Spaces are
    those of one simulation, as PettingZoo has no batches. All simulations are truncated at the same
    step, the 1000th; a protective stop ends one before. Such a step returns the next episode's
    first observations, and the ended episode's last ones as `infos[agent]["final_obs"]`. So
    `agents` never becomes empty.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's own type
        "name": "assistax_vector",
        "render_modes": [],
        "is_parallelizable": True,
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
            partners: Partners in the human's seats, a new one each episode; the robot is then the
                only agent. By default both seats are agents.
            disability: Setting of an agent's human; of several, each episode draws one.
            backend: See `assistax_envs.make`.
            weights: Reward weights that replace those of the task.
            arrays: Type of returned arrays: "numpy", or "jax", which must not be changed.
            version: Version of the environment; the newest if not given.

        Raises:
            ValueError: An argument is not allowed.
        """
        self.render_mode = None
        self.possible_agents = list(ROLES[:1] if partners else ROLES)
        self.agents: list[str] = []
        batch = Batch(task, partners or Idle(disability), num_envs, backend, weights, version)
        self._host, self._rng = HostBatch(batch, arrays), np.random.default_rng()
        self.num_envs, env = num_envs, batch.env
        self.observation_spaces = {
            role: _box(OBSERVATION_BOUND, env.observation_size[role])
            for role in self.possible_agents
        }
        self.action_spaces = {
            role: _box(1.0, env.action_size[role]) for role in self.possible_agents
        }
        self.state_space = _box(OBSERVATION_BOUND, env.observation_size["global"])

    def observation_space(self, agent: str) -> gymnasium.Space:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Begin an episode in every simulation; `options` are not used."""
        if checked_seed(seed) is not None:
            self._rng = np.random.default_rng(seed)
        obs = self._host.reset(self._rng)
        self.agents = list(self.possible_agents)
        return {role: obs[role] for role in self.agents}, {role: {} for role in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any], dict[str, dict[str, Any]]
    ]:
        """Advance by 20 ms; actions [N, A] of each agent are clipped to [-1, 1].

        Beside them may stand "word" [N], what human agents say, codes of `preferences.WORDS`.

        Raises:
            ValueError: No episode was started yet, or an agent's actions are missing or of the
                wrong shape.
        """
        if missing := [role for role in self.possible_agents if role not in actions]:
            raise ValueError(f"no actions of the {missing[0]}; give those of every agent")
        speaking = ["word"] if "human" in self.possible_agents and "word" in actions else []
        taken = {name: actions[name] for name in (*self.possible_agents, *speaking)}
        step, ended = self._host.step(self._rng, taken)
        step = self._host.out(step)
        infos = {role: dict(step.info) for role in self.agents}
        if ended.any():
            infos = {role: {**infos[role], "final_obs": step.final_obs[role]} for role in infos}
        return (
            {role: step.obs[role] for role in self.agents},
            dict.fromkeys(self.agents, step.reward),
            dict.fromkeys(self.agents, step.terminated),
            dict.fromkeys(self.agents, step.truncated),
            infos,
        )

    def state(self) -> Any:
        """Return the observations for central critics, `global` [N, O]."""
        return self._host.out(self._host.state.env.obs["global"])

    def close(self) -> None:
        """Do nothing: there is no window."""


def parallel_env(task: str, **options: Any) -> AssistaxParallelEnv:
    """Return the environment; the function's name is that of PettingZoo's own modules."""
    return AssistaxParallelEnv(task, **options)


def _box(bound: float, size: int) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-bound, bound, (size,), np.float32)
