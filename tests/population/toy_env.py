"""A two-role environment in pure JAX, with rewards whose optimum is known."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Reward = Callable[["ToyState", dict[str, jax.Array]], dict[str, jax.Array]]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ToyMeasures:
    success: jax.Array
    force: jax.Array
    distance: jax.Array
    contact: jax.Array | None = None  # of gentle tasks alone
    violated: jax.Array | None = None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ToyState:
    cue: dict[str, jax.Array]  # what each role has to know [N]
    obs: dict[str, jax.Array]
    reward: jax.Array
    terms: dict[str, jax.Array]
    measures: ToyMeasures
    terminated: jax.Array
    truncated: jax.Array
    step: jax.Array
    nonfinite: jax.Array
    params: Any
    key: jax.Array


def _measured(success: jax.Array) -> ToyMeasures:
    zero = jnp.zeros(success.shape)
    return ToyMeasures(success, zero, zero)


class ToyEnv:
    """Each role sees its own cue, +1 or -1; `reward` turns cues and actions [N] into terms [N].

    Args:
        reward: Reward terms of a state and the roles' first actions.
        episode_length: Steps of an episode.
        memory: Whether a cue is shown on an episode's first step only and then stays the same.
        terminates: Whether episodes end by termination instead of the time limit.
        observation_size, action_size: Widths; what is beyond the first column is noise and has no
        effect.
    """

    task = "toy"
    backend = "jax"
    version = 1

    def __init__(
        self,
        reward: Reward,
        episode_length: int = 20,
        memory: bool = False,
        terminates: bool = False,
        observation_size: tuple[int, int, int] = (2, 3, 4),
        action_size: tuple[int, int] = (1, 2),
    ) -> None:
        self.reward = reward
        self.episode_length = episode_length
        self.memory = memory
        self.terminates = terminates
        self.observation_size = dict(
            zip(("robot", "human", "global"), observation_size, strict=True)
        )
        self.action_size = dict(zip(("robot", "human"), action_size, strict=True))
        self.term_names = tuple(
            jax.eval_shape(self._blank, jax.random.split(jax.random.key(0), 2), None).terms
        )

    def reset(self, keys: jax.Array, params: Any) -> ToyState:
        return self._blank(keys, params)

    def step(self, state: ToyState, action: dict[str, jax.Array]) -> ToyState:
        action = {role: jnp.clip(value[:, 0], -1.0, 1.0) for role, value in action.items()}
        terms = self.reward(state, action)
        reward = sum(terms.values(), start=jnp.zeros(state.step.shape))
        step = state.step + 1
        ended = step >= self.episode_length
        cue = state.cue if self.memory else self._cues(state.key, step)
        return dataclasses.replace(
            state,
            cue=cue,
            obs=self._observe(cue, state.key, step, shown=not self.memory),
            reward=reward,
            terms=terms,
            measures=_measured(reward > 0.9),
            terminated=ended if self.terminates else jnp.zeros_like(ended),
            truncated=jnp.zeros_like(ended) if self.terminates else ended,
            step=step,
        )

    @staticmethod
    def joint_positions(state: ToyState) -> dict[str, jax.Array]:
        """One joint each, which never turns."""
        return dict.fromkeys(("robot", "human"), jnp.zeros((state.step.shape[0], 1)))

    def _blank(self, keys: jax.Array, params: Any) -> ToyState:
        n = keys.shape[0]
        step, false = jnp.zeros(n, jnp.int32), jnp.zeros(n, bool)
        cue = self._cues(keys, step)
        state = ToyState(
            cue=cue,
            obs=self._observe(cue, keys, step, shown=True),
            reward=jnp.zeros(n),
            terms={},
            measures=_measured(false),
            terminated=false,
            truncated=false,
            step=step,
            nonfinite=false,
            params=params,
            key=keys,
        )
        terms = self.reward(state, {role: jnp.zeros(n) for role in cue})
        return dataclasses.replace(state, terms=dict.fromkeys(terms, jnp.zeros(n)))

    def _cues(self, keys: jax.Array, step: jax.Array) -> dict[str, jax.Array]:
        draw = jax.vmap(
            lambda key, step: jax.random.rademacher(
                jax.random.fold_in(key, step), (2,), jnp.float32
            )
        )
        cues = draw(keys, step)
        return {"robot": cues[:, 0], "human": cues[:, 1]}

    def _observe(
        self, cue: dict[str, jax.Array], keys: jax.Array, step: jax.Array, shown: bool
    ) -> dict[str, jax.Array]:
        n, width = keys.shape[0], max(self.observation_size.values())
        noise = jnp.broadcast_to(jnp.sin(step.astype(jnp.float32))[:, None], (n, width))
        columns = {role: [cue[role] * shown] for role in cue} | {
            "global": [cue["robot"] * shown, cue["human"] * shown]
        }
        return {
            name: jnp.concatenate(
                [jnp.stack(first, 1), noise[:, len(first) : self.observation_size[name]]], 1
            )
            for name, first in columns.items()
        }


def constant(state: ToyState, action: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Reward 1 whatever is done: the value is 1 / (1 - gamma) under a time limit."""
    return {"constant": jnp.ones_like(action["robot"])}


def match(state: ToyState, action: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Reward at most 1 a step, when each role's action is half its own cue."""
    return {
        role: 0.5 - jnp.square(action[role] - 0.5 * state.cue[role]) for role in ("robot", "human")
    }


def together(state: ToyState, action: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Reward at most 1 a step, if both act on their cue: either alone earns 0 on average."""
    return {"together": action["robot"] * state.cue["robot"] * action["human"] * state.cue["human"]}


def numpy_gae(reward, value, next_value, terminated, truncated, gamma, lam) -> np.ndarray:
    """Return the sums of discounted errors up to each episode's end, by the definition."""
    steps, simulations = reward.shape
    result = np.zeros_like(reward)
    for n in range(simulations):
        for start in range(steps):
            weight = 1.0
            for t in range(start, steps):
                bootstrap = 0.0 if terminated[t, n] else next_value[t, n]
                result[start, n] += weight * (reward[t, n] + gamma * bootstrap - value[t, n])
                if terminated[t, n] or truncated[t, n]:
                    break
                weight *= gamma * lam
    return result
