"""Batch of N simulations with partners inside, which the vector adapters share.

All functions are pure, to be compiled by their caller. All simulations reach the time limit at the
same step; a protective stop ends an episode before. A step that ends an episode returns the next
one's start.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_base.errors import shorten
from assistax_envs.adapters.partners import Partners
from assistax_envs.env import EnvState, make, select
from assistax_envs.own_settings import key_of, own_settings

# Adapters clip observations to it, so that their spaces are finite. Robots that strike at
# random reach 1,133, a force in N; everything else is far smaller.
OBSERVATION_BOUND = 10_000.0
MOST_ENVS = 2**20


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BatchState:
    """State of all simulations and of their partners."""

    env: EnvState  # leaves [N, ...]
    params: Any  # the partners' arrays, which never change
    seated: Any  # this episode's partners and their memories
    first: jax.Array  # [N] bool: an episode begins


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BatchStep:
    """Result of a step, [N, ...] each; observations by "robot", "human" and "global"."""

    obs: dict[str, jax.Array]  # after an episode's last step those of the next episode
    final_obs: dict[str, jax.Array]  # those that the step itself led to
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    info: dict[str, Any]


class Batch:
    """Batch of N simulations of a task; `partners` act for the humans unless actions are given."""

    def __init__(
        self,
        task: str,
        partners: Partners,
        num_envs: int,
        backend: str = "auto",
        weights: dict[str, float] | None = None,
        version: int | None = None,
    ) -> None:
        if not isinstance(num_envs, int | np.integer) or not 1 <= num_envs <= MOST_ENVS:
            raise ValueError(f"num_envs is {num_envs!r}; allowed is 1 to {MOST_ENVS}")
        self.env = make(task, backend, weights, version)
        self.partners, self.num_envs = partners, int(num_envs)

    @own_settings()
    def reset(self, key: jax.Array) -> tuple[dict[str, jax.Array], BatchState]:
        """Return observations and state at the start of an episode in every simulation."""
        params = self.partners.params
        seated, state = self._begin(params, key, None)
        return _bounded(state.obs), BatchState(state, params, seated, state.step == 0)

    @own_settings()
    def step(
        self, key: jax.Array, state: BatchState, actions: Mapping[str, jax.Array]
    ) -> tuple[BatchState, BatchStep]:
        """Return state and step after 20 ms; an episode's last step begins the next one.

        All simulations reach the time limit at the same step. If a protective stop ended an episode
        before, the next one begins with the same partner and ends at that limit.

        Args:
            key: Key of episodes that begin after this step.
            state: State that `reset` or `step` returned.
            actions: "robot" [N, 7], and "human" [N, 3] in place of the partners' own, who speak
                otherwise. With "human" may come "word" [N] int32, codes of `preferences.WORDS`.
        """
        before, seated = state.env, state.seated
        if "human" not in actions:
            seated, action = self.partners.act(
                state.params, seated, before.obs["human"], state.first
            )
            actions = {**actions, "human": action} | self._said(seated)
        given = [name for name in (*self.env.action_size, "word") if name in actions]
        after = self.env.step(before, {name: actions[name] for name in given})
        limit, stopped = after.truncated[0], after.terminated
        new_seated, new = jax.lax.cond(
            limit,
            lambda: self._begin(state.params, key, seated),
            lambda: (seated, self._after_stops(key, after)),
        )
        step = BatchStep(
            obs=_bounded(new.obs),
            final_obs=_bounded(after.obs),
            reward=after.reward,
            terminated=after.terminated,
            truncated=after.truncated,
            info=_info(after),
        )
        return BatchState(new, state.params, new_seated, stopped | limit), step

    def _said(self, seated: Any) -> dict[str, jax.Array]:
        """Return the words [N] that the partners said with their last actions, if they can."""
        speaking: Any = self.partners
        word = speaking.word(seated, self.num_envs) if hasattr(speaking, "word") else None
        return {} if word is None else {"word": word}

    def _after_stops(self, key: jax.Array, after: EnvState) -> EnvState:
        """Return the state with new episodes in place of stopped ones, with the same time limit."""

        def anew() -> EnvState:
            fresh = self.env.reset(jax.random.split(key, self.num_envs), after.params)
            fresh = dataclasses.replace(fresh, step=after.step)
            return select(after.terminated, fresh, after)

        return jax.lax.cond(after.terminated.any(), anew, lambda: after)

    def _begin(self, params: Any, key: jax.Array, before: Any) -> tuple[Any, EnvState]:
        """Return the partners of new episodes and the environment's state at their start."""
        of_partners, of_starts = jax.random.split(key)
        seated, humans = self.partners.begin(params, of_partners, before, self.num_envs)
        return seated, self.env.reset(jax.random.split(of_starts, self.num_envs), humans)


class HostBatch:
    """Batch that is stepped from outside JAX: compiled, with keys drawn from a generator."""

    def __init__(self, batch: Batch, arrays: str = "numpy") -> None:
        if arrays not in ("numpy", "jax"):
            raise ValueError(f"arrays is {arrays!r}; allowed are 'numpy' and 'jax'")
        self.batch, self._arrays = batch, arrays
        self._reset, self._step = jax.jit(batch.reset), jax.jit(self._stepped)
        self._state: BatchState | None = None
        self._key = key_of(0)
        self._steps = 0  # steps of this episode, counted without asking a device

    @property
    def state(self) -> BatchState:
        """The state of all simulations.

        Raises:
            ValueError: Nothing was reset yet.
        """
        if self._state is None:
            raise ValueError("no episode runs yet; call reset() first")
        return self._state

    @own_settings()
    def reset(self, rng: np.random.Generator) -> dict[str, Any]:
        """Return the observations at the start of an episode in every simulation."""
        obs, self._state = self._reset(_draw(rng))
        self._key, self._steps = _draw(rng), 0
        return self.out(obs)

    @own_settings()
    def step(
        self, rng: np.random.Generator, actions: Mapping[str, Any]
    ) -> tuple[BatchStep, np.ndarray]:
        """Advance by 20 ms; return the step, as JAX arrays, and the mask of ended episodes [N]."""
        taken = {
            role: self._words(action) if role == "word" else self._action(role, action)
            for role, action in actions.items()
        }
        self._state, step = self._step(self._key, np.int32(self._steps), self.state, taken)
        self._steps += 1
        limit = self._steps == self.batch.env.episode_length
        ended = np.full(self.batch.num_envs, limit)
        if limit:
            self._key, self._steps = _draw(rng), 0
        elif self.batch.env.stops:
            ended = np.asarray(step.terminated)
        return step, ended

    def _stepped(
        self, key: jax.Array, number: jax.Array, state: BatchState, actions: dict[str, jax.Array]
    ) -> tuple[BatchState, BatchStep]:
        return self.batch.step(jax.random.fold_in(key, number), state, actions)

    @own_settings()
    def partner_names(self) -> list[str]:
        """Return the name of each simulation's partner."""
        return self.batch.partners.names(self.state.seated, self.batch.num_envs)

    @own_settings()
    def out(self, tree: Any) -> Any:
        """Return JAX arrays as callers want them; NumPy arrays are copies that they may change."""
        return tree if self._arrays == "jax" else jax.tree.map(np.array, tree)

    def _action(self, role: str, action: Any) -> jax.Array:
        """Return checked actions as a copy, since the caller may overwrite them during the step."""
        if not isinstance(action, np.ndarray | jax.Array) and hasattr(action, "__dlpack__"):
            # JAX refuses strided arrays, such as the slices that PyTorch's `chunk` returns.
            action = jnp.from_dlpack(getattr(action, "contiguous", lambda: action)())
        copied = jax.block_until_ready(jnp.array(action, jnp.float32))
        expected = self.batch.num_envs, self.batch.env.action_size[role]
        if copied.shape != expected:
            raise ValueError(
                f"actions of the {role} have shape {copied.shape}; expected {expected}, values in "
                "[-1, 1]"
            )
        return copied

    def _words(self, words: Any) -> jax.Array:
        """Return checked words as a copy."""
        copied = jax.block_until_ready(jnp.array(words, jnp.int32))
        if copied.shape != (self.batch.num_envs,):
            raise ValueError(
                f"words have shape {copied.shape}; expected ({self.batch.num_envs},), codes of "
                "assistax_envs.preferences"
            )
        return copied


def checked_seed(seed: Any) -> int | None:
    """Return the seed of a reset, or None.

    Raises:
        ValueError: It is not one whole number: simulations have no seeds of their own.
    """
    whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if seed is None:
        return None
    if whole and seed >= 0:
        return int(seed)
    raise ValueError(
        f"seed is {shorten(seed)}; give one whole number from 0, from which all simulations "
        "are drawn"
    )


def _draw(rng: np.random.Generator) -> jax.Array:
    return key_of(int(rng.integers(2**32, dtype=np.uint32)))


def _bounded(obs: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return {
        name: jnp.clip(value, -OBSERVATION_BOUND, OBSERVATION_BOUND) for name, value in obs.items()
    }


def _info(state: EnvState) -> dict[str, Any]:
    """Return the measures of a step and its reward terms by name."""
    measures = {name: getattr(state.measures, name) for name in ("force", "distance", "success")}
    if state.measures.violated is not None:
        measures["violated"] = state.measures.violated
    return {**measures, "nonfinite": state.nonfinite, "terms": state.terms}
