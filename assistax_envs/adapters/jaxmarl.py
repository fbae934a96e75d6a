"""JaxMARL's functional interface, without a dependency on JaxMARL.

Signatures are those of one simulation, as in JaxMARL. `jax.vmap` over them, which its trainers rely
on, never maps over the physics: each level of vmap becomes rows of the environment's own batch.
Batches of the form [N, ...] can be given without vmap too (`reset_batch`, `step_batch`), which
compiles faster. `AssistaxMarlVectorEnv` has the batch inside, and partners that change each
episode.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from assistax_envs.adapters.batch import OBSERVATION_BOUND, Batch, BatchState
from assistax_envs.adapters.partners import Idle, Partners
from assistax_envs.disability import Disability
from assistax_envs.env import EnvState, disability_params, make, select
from assistax_envs.own_settings import GENERATOR, own_settings

Step = tuple[
    dict[str, jax.Array], EnvState, dict[str, jax.Array], dict[str, jax.Array], dict[str, jax.Array]
]


@dataclasses.dataclass(frozen=True)
class Box:
    """Space of arrays between two bounds, with the fields of JaxMARL's space of that name."""

    low: float
    high: float
    shape: tuple[int, ...]
    dtype: Any = jnp.float32

    def sample(self, rng: jax.Array) -> jax.Array:
        """Return a uniform draw; standard normal if a bound is infinite."""
        if math.isinf(self.low) or math.isinf(self.high):
            return jax.random.normal(rng, self.shape, self.dtype)
        return jax.random.uniform(rng, self.shape, self.dtype, self.low, self.high)

    def contains(self, x: jax.Array) -> jax.Array:
        """Return whether all of `x` lies within the bounds."""
        return jnp.all((x >= self.low) & (x <= self.high))


class AssistaxMarlEnv:
    """Task for the agents "robot" and "human" by JaxMARL's rules.

    A step resets a simulation that is done.

    Rewards and dones are by agent and under "__all__"; `done` is the time limit, for an episode
    ends by time only. `infos` are [2], a value for each agent, as JaxMARL's scripts reshape them.
    """

    def __init__(
        self,
        task: str,
        disability: str | Disability = "d1",
        backend: str = "auto",
        weights: dict[str, float] | None = None,
    ) -> None:
        """See `assistax_envs.make`; `disability` is the human's, "d1".."d9" or a `Disability`."""
        self.env = make(task, backend, weights)
        self.name = f"assistax_{task}"
        self.agents = ["robot", "human"]
        self.num_agents = len(self.agents)
        self.agent_classes = {agent: [agent] for agent in self.agents}
        sizes = self.env.observation_size
        self.observation_spaces = {
            agent: Box(-math.inf, math.inf, (sizes[agent],)) for agent in self.agents
        }
        self.action_spaces = {
            agent: Box(-1.0, 1.0, (self.env.action_size[agent],)) for agent in self.agents
        }
        self._disability = disability
        self._reset = _batched(self.reset_batch)
        self._step_env = _batched(self._step_env_batch)
        self._step = _batched(self.step_batch)
        self._step_to = _batched(self._step_to_batch)

    @own_settings()
    def reset(self, key: jax.Array) -> tuple[dict[str, jax.Array], EnvState]:
        """Start an episode; `key` is typed or raw."""
        return _first(self._reset(_rows(_typed(key))))

    @own_settings()
    def step(
        self,
        key: jax.Array,
        state: EnvState,
        actions: dict[str, jax.Array],
        reset_state: EnvState | None = None,
    ) -> Step:
        """Advance by one control step; if it ends the episode, return the next one's start.

        Args:
            key: key of the next episode's start.
            state: state of the simulation; its leaves have no batch axis.
            actions: "robot" [7] and "human" [3] in [-1, 1] (clipped).
            reset_state: start of the next episode, instead of a random start.
        """
        given = _rows((_typed(key), state, actions))
        if reset_state is None:
            return _first(self._step(*given))
        return _first(self._step_to(*given[1:], _rows(reset_state)))

    @own_settings()
    def step_env(self, key: jax.Array, state: EnvState, actions: dict[str, jax.Array]) -> Step:
        """Return the result of a control step without a reset; `key` is not used."""
        del key
        return _first(self._step_env(*_rows((state, actions))))

    @own_settings()
    def reset_batch(self, keys: jax.Array) -> tuple[dict[str, jax.Array], EnvState]:
        """Return observations and state of N new episodes from keys [N], like `jax.vmap(reset)`."""
        keys = _typed(keys)
        params = jax.tree.map(
            lambda leaf: jnp.broadcast_to(leaf, keys.shape), disability_params([self._disability])
        )
        state = self.env.reset(keys, params)
        return self.get_obs(state), state

    @own_settings()
    def step_batch(self, keys: jax.Array, state: EnvState, actions: dict[str, jax.Array]) -> Step:
        """Return the result of a step of N simulations, as `jax.vmap(env.step)` does.

        Resets cost nothing while no simulation is done.
        """
        _, after, rewards, dones, infos = self._step_env_batch(state, actions)
        after = jax.lax.cond(
            jnp.any(dones["__all__"]),
            lambda: select(dones["__all__"], self.reset_batch(keys)[1], after),
            lambda: after,
        )
        return self.get_obs(after), after, rewards, dones, infos

    def get_obs(self, state: EnvState) -> dict[str, jax.Array]:
        """Return the observations by agent."""
        return {agent: state.obs[agent] for agent in self.agents}

    def get_world_state(self, state: EnvState) -> jax.Array:
        """Return the observation for central critics."""
        return state.obs["global"]

    def get_avail_actions(self, state: EnvState) -> dict[str, jax.Array]:
        """Return ones: every action is available, as in JaxMARL's continuous environments."""
        return {agent: jnp.ones(space.shape) for agent, space in self.action_spaces.items()}

    def observation_space(self, agent: str) -> Box:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        return self.action_spaces[agent]

    def _step_env_batch(self, state: EnvState, actions: dict[str, jax.Array]) -> Step:
        """Return the result of a step of N simulations without resets."""
        after = self.env.step(state, {agent: actions[agent] for agent in self.agents})
        names = (*self.agents, "__all__")
        dones = dict.fromkeys(names, after.terminated | after.truncated)
        values = {
            **after.terms,
            "force": after.measures.force,
            "success": after.measures.success,
            "truncated": after.truncated,
            "nonfinite": after.nonfinite,
        }
        infos = {
            name: jnp.stack([value] * self.num_agents, axis=-1) for name, value in values.items()
        }
        return self.get_obs(after), after, dict.fromkeys(names, after.reward), dones, infos

    def _step_to_batch(
        self, state: EnvState, actions: dict[str, jax.Array], reset_state: EnvState
    ) -> Step:
        """Return the result of a step of N simulations; done ones continue from `reset_state`."""
        _, after, rewards, dones, infos = self._step_env_batch(state, actions)
        after = select(dones["__all__"], reset_state, after)
        return self.get_obs(after), after, rewards, dones, infos


class AssistaxMarlVectorEnv:
    """Hundreds of simulations by JaxMARL's rules, with the batch inside: never map over it.

    Signatures are JaxMARL's, with an axis N of simulations in front of every array but the key.
    Each simulation gets a new partner in every episode. All episodes end at the same step, which
    returns the next one's start. The environment runs inside jit and scan.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 512,
        partners: Partners | None = None,
        disability: str | Disability | Sequence[str | Disability] = "d1",
        backend: str = "auto",
        weights: dict[str, float] | None = None,
        version: int | None = None,
    ) -> None:
        """Make the environment; with partners "robot" is the only agent.

        Args:
            task: One of `assistax_envs.TASKS`.
            num_envs: N, simulations.
            partners: Partners in the human's seats; by default "human" is an agent too.
            disability: Setting of an agent's human; of several, each episode draws one.
            backend: See `assistax_envs.make`.
            weights: Reward weights that replace those of the task.
            version: Version of the environment; the newest if not given.
        """
        self.batch = Batch(task, partners or Idle(disability), num_envs, backend, weights, version)
        self.name, self.num_envs = f"assistax_{task}", num_envs
        self.agents = ["robot"] if partners else ["robot", "human"]
        self.num_agents = len(self.agents)
        env = self.batch.env
        self.observation_spaces = {
            agent: Box(-OBSERVATION_BOUND, OBSERVATION_BOUND, (env.observation_size[agent],))
            for agent in self.agents
        }
        self.action_spaces = {
            agent: Box(-1.0, 1.0, (env.action_size[agent],)) for agent in self.agents
        }

    @own_settings()
    def reset(self, key: jax.Array) -> tuple[dict[str, jax.Array], BatchState]:
        """Begin an episode in every simulation; `key` is one key, typed or raw."""
        obs, state = self.batch.reset(_typed(key))
        return {agent: obs[agent] for agent in self.agents}, state

    @own_settings()
    def step(
        self, key: jax.Array, state: BatchState, actions: dict[str, jax.Array]
    ) -> tuple[
        dict[str, jax.Array],
        BatchState,
        dict[str, jax.Array],
        dict[str, jax.Array],
        dict[str, Any],
    ]:
        """Advance by 20 ms; `key` starts the next episode if this step is the last one.

        Rewards and dones are [N], by agent and under "__all__"; infos are [N, agents]. Beside the
        actions may stand "word" [N], what human agents say, codes of `preferences.WORDS`.
        """
        speaking = ["word"] if "human" in self.agents and "word" in actions else []
        taken = {name: actions[name] for name in (*self.agents, *speaking)}
        state, step = self.batch.step(_typed(key), state, taken)
        names = (*self.agents, "__all__")
        info = {**step.info["terms"], **step.info, "truncated": step.truncated}
        del info["terms"]
        return (
            {agent: step.obs[agent] for agent in self.agents},
            state,
            dict.fromkeys(names, step.reward),
            dict.fromkeys(names, step.terminated | step.truncated),
            {name: jnp.stack([value] * self.num_agents, axis=-1) for name, value in info.items()},
        )

    def get_world_state(self, state: BatchState) -> jax.Array:
        """Return the observations for central critics."""
        return state.env.obs["global"]

    def observation_space(self, agent: str) -> Box:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        return self.action_spaces[agent]


def _batched(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` of arguments [N, ...] whose vmap calls it once, with merged axes."""
    mapped = jax.custom_batching.custom_vmap(function)

    @mapped.def_vmap
    def rule(size: int, batched: Any, *arguments: Any) -> tuple[Any, Any]:
        repeated = [
            jax.tree.map(
                lambda leaf, is_mapped: leaf if is_mapped else _repeat(leaf, size), argument, mask
            )
            for argument, mask in zip(arguments, batched, strict=True)
        ]
        merged = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), repeated)
        result = jax.tree.map(lambda leaf: leaf.reshape(size, -1, *leaf.shape[1:]), again(*merged))
        return result, jax.tree.map(lambda _: True, result)

    def again(*arguments: Any) -> Any:
        return _batched(function)(*arguments)

    return mapped


def _repeat(leaf: jax.Array, size: int) -> jax.Array:
    return jnp.broadcast_to(leaf[None], (size, *leaf.shape))


def _typed(key: jax.Array) -> jax.Array:
    """Return typed keys; raw ones get our generator, whatever this process's default is."""
    if jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        return key
    if key.shape[-1:] != (2,):
        raise ValueError(
            f"a raw key has {key.shape[-1:]} words, and one of {GENERATOR} has 2; make it with "
            f"jax.random.key(seed, impl={GENERATOR!r})"
        )
    return jax.random.wrap_key_data(key, impl=GENERATOR)


def _rows(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], tree)


def _first(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[0], tree)
