"""N simulations that begin and end together, partners within: what the vector adapters share.

Everything is a pure function, to be compiled by whoever calls it. All simulations reach the time
limit at the same step; a protective stop ends an episode before. A step that ends an episode
already returns the next one's start.
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

# Vector forms cut observations there, so that their spaces are finite. Robots that strike at random
# reach 1,133, a force in N; everything else is far smaller.
OBSERVATION_BOUND = 10_000.0
MOST_ENVS = 2**20


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BatchState:
    """All simulations, and who sits in them."""

    env: EnvState  # leaves [N, ...]
    params: Any  # the partners' arrays, which never change
    seated: Any  # this episode's partners, and what they remember
    first: jax.Array  # [N] bool: an episode begins


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BatchStep:
    """What a step returns, [N, ...] each; observations by "robot", "human" and "global"."""

    obs: dict[str, jax.Array]  # after a last step: of the next episode
    final_obs: dict[str, jax.Array]  # that the step itself led to
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    info: dict[str, Any]


class Batch:
    """N simulations of a task whose humans are `partners`, unless their actions are handed in."""

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
        """Begin an episode in every simulation; return the observations and the state."""
        params = self.partners.params
        seated, state = self._begin(params, key, None)
        return _bounded(state.obs), BatchState(state, params, seated, state.step == 0)

    @own_settings()
    def step(
        self, key: jax.Array, state: BatchState, actions: Mapping[str, jax.Array]
    ) -> tuple[BatchState, BatchStep]:
        """Advance by 20 ms; after an episode's last step begin the next, with new partners.

        All simulations reach the time limit at the same step. Where a protective stop ended an
        episode before, the next one begins with the same partner, and lasts until then.

        Args:
            key: Of episodes that begin after this step.
            state: What `reset` or `step` returned.
            actions: "robot" [N, 7], and "human" [N, 3] in place of the partners' own.
        """
        before, seated = state.env, state.seated
        if "human" not in actions:
            seated, action = self.partners.act(
                state.params, seated, before.obs["human"], state.first
            )
            actions = {**actions, "human": action}
        after = self.env.step(before, {role: actions[role] for role in self.env.action_size})
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

    def _after_stops(self, key: jax.Array, after: EnvState) -> EnvState:
        """Begin episodes anew where a protective stop ended them, as late as the others are."""

        def anew() -> EnvState:
            fresh = self.env.reset(jax.random.split(key, self.num_envs), after.params)
            fresh = dataclasses.replace(fresh, step=after.step)
            return select(after.terminated, fresh, after)

        return jax.lax.cond(after.terminated.any(), anew, lambda: after)

    def _begin(self, params: Any, key: jax.Array, before: Any) -> tuple[Any, EnvState]:
        of_partners, of_starts = jax.random.split(key)
        seated, humans = self.partners.begin(params, of_partners, before, self.num_envs)
        return seated, self.env.reset(jax.random.split(of_starts, self.num_envs), humans)


class HostBatch:
    """A batch that is stepped from outside JAX: compiled, with keys drawn from a generator."""

    def __init__(self, batch: Batch, arrays: str = "numpy") -> None:
        if arrays not in ("numpy", "jax"):
            raise ValueError(f"arrays is {arrays!r}; allowed are 'numpy' and 'jax'")
        self.batch, self._arrays = batch, arrays
        self._reset, self._step = jax.jit(batch.reset), jax.jit(self._stepped)
        self._state: BatchState | None = None
        self._key = key_of(0)
        self._steps = 0  # of this episode: counted here, no device needs to be asked

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
        """Begin an episode in every simulation; return the observations."""
        obs, self._state = self._reset(_draw(rng))
        self._key, self._steps = _draw(rng), 0
        return self.out(obs)

    @own_settings()
    def step(
        self, rng: np.random.Generator, actions: Mapping[str, Any]
    ) -> tuple[BatchStep, np.ndarray]:
        """Advance by 20 ms; return the step, as JAX arrays, and which episodes it ended [N]."""
        taken = {role: self._action(role, action) for role, action in actions.items()}
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
        """Return what the partner of each simulation is called."""
        return self.batch.partners.names(self.state.seated, self.batch.num_envs)

    @own_settings()
    def out(self, tree: Any) -> Any:
        """Return JAX arrays as callers want them; NumPy's are copies, which they may change."""
        return tree if self._arrays == "jax" else jax.tree.map(np.array, tree)

    def _action(self, role: str, action: Any) -> jax.Array:
        """Return an own copy: what was handed in may be overwritten while the step still runs."""
        if not isinstance(action, np.ndarray | jax.Array) and hasattr(action, "__dlpack__"):
            # JAX takes no slices, such as the means that PyTorch's `chunk` cuts out of an output.
            action = jnp.from_dlpack(getattr(action, "contiguous", lambda: action)())
        copied = jax.block_until_ready(jnp.array(action, jnp.float32))
        expected = self.batch.num_envs, self.batch.env.action_size[role]
        if copied.shape != expected:
            raise ValueError(
                f"actions of the {role} have shape {copied.shape}; expected {expected}, values in "
                "[-1, 1]"
            )
        return copied


def checked_seed(seed: Any) -> int | None:
    """Return the seed of a reset.

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
    """Return what a step says beside its reward."""
    measures = {name: getattr(state.measures, name) for name in ("force", "distance", "success")}
    if state.measures.violated is not None:
        measures["violated"] = state.measures.violated
    return {**measures, "nonfinite": state.nonfinite, "terms": state.terms}
