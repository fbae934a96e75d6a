"""A 2x2 matrix game in the environment's protocol, and policies that always choose alike.

Reward of a step: PAYOFF[row, column] times the partner's strength ("payoff"), and a draw of the
episode's key ("luck"). Row and column are the signs of the actions. Human observations hold the
step, so that a policy can depend on it.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evaluation.cast.roster import HostEgo, Member, Roster
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack

PAYOFF = np.array([[4.0, 1.0], [0.5, 3.0]], np.float32)
ROBOT = PolicySpec("robot", observation_size=3, action_size=2, hidden=(4,), normalise=False)
HUMAN = PolicySpec("human", observation_size=2, action_size=1, hidden=(4,), normalise=False)
GRU = dataclasses.replace(ROBOT, torso="gru", hidden=(4, 4))


class Measures(NamedTuple):
    force: jax.Array
    distance: jax.Array
    success: jax.Array
    contact: jax.Array | None = None
    violated: jax.Array | None = None


class State(NamedTuple):
    obs: dict[str, jax.Array]
    reward: jax.Array
    terms: dict[str, jax.Array]
    measures: Measures
    terminated: jax.Array
    truncated: jax.Array
    step: jax.Array
    nonfinite: jax.Array
    params: Any
    luck: jax.Array


@dataclasses.dataclass(frozen=True)
class MatrixGame:
    """The game; `limit` steps an episode, of which those from `broken_from` on are non-finite."""

    episode_length: int = 4
    broken_from: int = 10**6
    task: str = "matrix"
    backend: str = "native"
    version: int = 1
    observation_size = {"robot": 3, "human": 2, "global": 3}  # noqa: RUF012
    action_size = {"robot": 2, "human": 1}  # noqa: RUF012
    term_names = ("payoff", "luck")

    def reset(self, keys: jax.Array, params: Any) -> State:
        count = keys.shape[0]
        luck = jax.vmap(jax.random.uniform)(keys)
        zero, false = jnp.zeros(count), jnp.zeros(count, bool)
        step = jnp.zeros(count, jnp.int32)
        terms = {"payoff": zero, "luck": zero}
        obs, measures = self._obs(luck, step), Measures(zero, zero, false)
        return State(obs, zero, terms, measures, false, false, step, false, params, luck)

    def step(self, state: State, actions: dict[str, jax.Array]) -> State:
        row, column = ((actions[role][:, 0] > 0).astype(int) for role in ("robot", "human"))
        step = state.step + 1
        broken = step > self.broken_from
        payoff = jnp.where(broken, 0.0, jnp.asarray(PAYOFF)[row, column] * state.params.strength)
        luck = jnp.where(broken, 0.0, state.luck)
        force = jnp.abs(actions["robot"][:, 1]) + step.astype(jnp.float32)
        force = jnp.where(broken, jnp.nan, force)
        success = (row == 1) & (column == 1) & (step == 2)
        return state._replace(
            obs=self._obs(state.luck, step),
            reward=payoff + luck,
            terms={"payoff": payoff, "luck": luck},
            measures=Measures(force, jnp.zeros_like(force), success),
            truncated=step == self.episode_length,
            step=step,
            nonfinite=broken,
        )

    @staticmethod
    def joint_positions(state: State) -> dict[str, jax.Array]:
        """Two joints of the robot that turn by 0.5 a step each, the human's by 0.25."""
        time = state.step.astype(jnp.float32)[:, None]
        return {"robot": jnp.concatenate([0.5 * time, -0.5 * time], axis=1), "human": 0.25 * time}

    @staticmethod
    def _obs(luck: jax.Array, step: jax.Array) -> dict[str, jax.Array]:
        time = step.astype(jnp.float32)
        robot = jnp.stack([luck, time, jnp.ones_like(luck)], -1)
        return {"robot": robot, "human": robot[:, :2], "global": robot}


def constant_params(spec: PolicySpec, values: list[float]) -> dict[str, Any]:
    """Return stacked parameters of policies whose every action is `values[g]`."""
    count, width = len(values), spec.hidden[0]
    head = np.tile(np.array(values, np.float32)[:, None], (1, spec.action_size))
    first, last = (count, spec.observation_size, width), (count, width, spec.action_size)
    bias = np.zeros((count, width), np.float32)
    return {
        "Dense_0": {"kernel": np.zeros(first, np.float32), "bias": bias},
        "Dense_1": {"kernel": np.zeros(last, np.float32), "bias": head},
        "log_std": np.full((count, spec.action_size), -1.0, np.float32),
    }


def roster(spec: PolicySpec, members: tuple[Member, ...], params: Any) -> Roster:
    """Return one stack of policies and their descriptions."""
    by_id = {member.id: member for member in members}
    return Roster((PolicyStack(spec, tuple(by_id), params),), by_id)


def _member(role: str, value: float, setting: str, seed: int) -> Member:
    team = f"matrix/hand-{setting}-s{seed}-v0"
    return Member(f"{team}/{role}", f"{role[0]}{value}", team, "hand", setting, seed)


def robots(*values: float) -> Roster:
    """Return egos that always act `values[e]`: row 1 if positive, else row 0."""
    members = tuple(_member("robot", value, "d1", i) for i, value in enumerate(values))
    return roster(ROBOT, members, constant_params(ROBOT, list(values)))


def humans(*values: float, disabilities: tuple[str, ...] = ()) -> Roster:
    """Return partners that always act `values[p]`, each with its own disability setting."""
    settings = disabilities or ("d1",) * len(values)
    named = enumerate(zip(values, settings, strict=True))
    members = tuple(_member("human", value, setting, i) for i, (value, setting) in named)
    return roster(HUMAN, members, constant_params(HUMAN, list(values)))


def host(act: Any, reusable: bool = True) -> Roster:
    """Return a robot from outside the zoo."""
    member = Member("python:mine:robot", "source", reusable=reusable)
    return Roster((HostEgo(member.id, act),), {member.id: member})


@functools.cache
def random_roster(spec: PolicySpec, count: int, seed: int, team: str = "random") -> Roster:
    """Return randomly initialised policies whose actions depend on observations."""
    # Not `vmap`: batches of QR factorisations, of which orthogonal initialisation is made, can
    # deadlock on two cores.
    params = jax.lax.map(Policy(spec).init, jax.random.split(jax.random.key(seed), count))
    params = jax.tree.map(lambda leaf: np.asarray(leaf) * 3.0, params)
    members = []
    for i in range(count):
        setting, digest = f"d{1 + i % 9}", f"{seed}-{i}"
        name = f"matrix/{team}-{setting}-s{i}-v0/{spec.role}"
        members.append(Member(name, digest, None, "random", setting, i))
    return roster(spec, tuple(members), params)
