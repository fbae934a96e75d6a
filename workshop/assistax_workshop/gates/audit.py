"""Audit of a task on trained teams: does it need its partner, and is it done gently?

A gate is a figure with a bar: the return of a script or a robot without a partner, the loss of
strangers, the worth of knowing the human's preference, and the force of touches. Every condition is
a job of the evaluator, so that episodes are stored, paired and resumed like any others.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl

from assistax_envs import disability_params, make
from assistax_envs.own_settings import key_of, own_settings
from assistax_envs.preferences import PREFERENCES, PREFERRED, VALUES, preferences_of
from assistax_envs.tasks.gentle_base import FELT
from assistax_envs.tasks.gentle_rules import HARD
from assistax_workshop.gates.audit_gates import (
    Condition,
    Gate,
    condition_figures,
    gates_of,
    strange_pairs,
)
from assistax_workshop.gates.audit_teams import Teams
from evaluation.cast.roster import Member, Roster
from evaluation.figures.normalised import PASSIVE
from evaluation.play.baselines import passive_roster, script_roster
from evaluation.play.evaluator import run_job
from evaluation.play.jobs import Job
from evaluation.play.progress import Progress
from evaluation.play.runner import share_cores
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack
from population.views import CONDITION

JOINT_SPEEDS = (2.175,) * 4 + (2.61,) * 3  # rad/s, of the robot's datasheet
HELD = (-1.0, 0.0, 1.0)  # constant torques of a held human, as shares of each joint's strength
EPISODES = 2 * len(PREFERENCES)  # of each pair: every preference twice
# Factor on the episodes of a team with itself, and of the script with a passive human: those are
# few pairs, and a rate of 0.01 must be distinguished from 0.
MORE = 10
BOTH = ("robot", "human")  # roles that are told the preference; by default the human alone


@dataclasses.dataclass(frozen=True)
class Audit:
    """Gates of a task, and the figures behind them by condition."""

    task: str
    env_version: int
    backend: str
    teams: tuple[str, ...]
    episodes: int  # of each pair
    gates: tuple[Gate, ...]
    figures: Mapping[str, Mapping[str, float]]  # condition -> mean return, safe success, ...


@dataclasses.dataclass(frozen=True)
class Others:
    """Policies for the gates that a task's own teams cannot measure; empty ones are left out."""

    passive: Teams | None = None  # robots that were trained with a passive human
    told: Teams | None = None  # teams whose robot is told the preference
    blind: Teams | None = None  # teams whose human is not told it
    recurrent: Teams | None = None  # teams whose robot has a memory
    response: Teams | None = None  # robot i was trained with the frozen human of team i
    # Robots that were trained with the frozen humans of some teams, and play with the others'.
    ego: Teams | None = None
    ego_told: Teams | None = None  # the same, told the preference
    ego_recurrent: Teams | None = None  # the same, with a memory


class WrongBeliefEnv:
    """Environment whose human observes another preference: the next force, speed and distance.

    The reward uses the true preference.
    """

    def __init__(self, env: Any) -> None:
        self._env = env
        self.engine = {**env.engine, CONDITION: "mistaken"}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, keys: jax.Array, params: Any) -> Any:
        """See `Env.reset`."""
        return self._exchanged(self._env.reset(keys, params))

    def step(self, state: Any, actions: dict[str, jax.Array]) -> Any:
        """See `Env.step`."""
        return self._exchanged(self._env.step(state, actions))

    def _exchanged(self, state: Any) -> Any:
        task, preference = self._env.task, state.task.preference
        other = {name: _next(getattr(preference, name), values) for name, values in VALUES.items()}
        believed = dataclasses.replace(preference, **other).observed(task)
        human = state.obs["human"].at[:, -len(PREFERRED[task]) :].set(believed)
        obs = {**state.obs, "human": human}
        return dataclasses.replace(state, obs=obs)


def audit_task(
    task: str,
    teams: Teams,
    others: Others,
    folder: Path,
    *,
    episodes: int = EPISODES,
    seed: int = 0,
    backend: str = "auto",
    version: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Audit:
    """Return the audit of a task: every condition with policies is played and its gates judged.

    Args:
        task: Any task; those of the paper have no preferences, and most gates fail.
        teams: Trained teams of several seeds, one disability setting.
        others: Policies for the other gates.
        folder: Folder of the episodes by condition, in which an interrupted audit resumes.
        episodes: Episodes of each pair; ten times as many of own teams, and of the script with a
            passive human.
        seed: Seed of the episodes.
        backend: Physics.
        version: Version of the environment; the newest if not given.
        on_progress: Called with the progress of each condition.
    """
    share_cores()
    _check(task, teams, others, episodes)
    table = _Tables(task, folder, episodes, seed, backend, version, on_progress)
    env = table.env()
    played = _play(table, env, teams, others)
    touch = touches(env, teams, episodes, seed)
    gates = gates_of(task, played, touch)
    played[Condition.STRANGERS] = strange_pairs(played.pop(Condition.PAIRS))
    figures = {
        str(name): condition_figures(table) for name, table in played.items() if table.height
    }
    about = task, env.version, env.backend, teams.robots.ids, episodes
    return Audit(*about, tuple(gates), figures | {str(Condition.TOUCH): touch})


def _check(task: str, teams: Teams, others: Others, episodes: int) -> None:
    """Refuse too few episodes, and policies that do not fit the teams or the task."""
    if episodes < 2:
        raise ValueError(f"episodes is {episodes}; give at least 2: half of them choose a posture")
    if others.response and len(others.response.robots.ids) != len(teams.humans.ids):
        raise ValueError(
            f"{len(others.response.robots.ids)} best responses for {len(teams.humans.ids)} teams; "
            "give one for each, in their order"
        )
    if task not in PREFERRED and (others.told or others.blind or others.ego_told):
        raise ValueError(
            f"the humans of {task} have no preferences; name no told or blind teams, and no told "
            "egos"
        )
    for egos in (others.ego, others.ego_told, others.ego_recurrent):
        if egos and set(teams.humans.ids) <= set(egos.met):
            raise ValueError("the egos were trained with every team; name teams they never met too")


def _play(
    table: "_Tables", env: Any, teams: Teams, others: Others
) -> dict[Condition, pl.DataFrame]:
    """Return the episodes of every condition that has policies."""
    task = table.task
    sizes = {role: (env.observation_size[role], env.action_size[role]) for role in teams.SEATS}
    passive, script = (
        passive_roster(*sizes["human"]),
        script_roster(task, *sizes["robot"]),
    )
    played = {
        Condition.OWN: table.play("own", teams.robots, teams.humans, paired=True, times=MORE),
        Condition.PAIRS: table.play("pairs", teams.robots, teams.humans),
        Condition.SCRIPT: table.play("script", script, passive, times=MORE),
        Condition.HELD: table.play("held", script, held_roster(*sizes["human"])),
        Condition.ALONE: table.play("alone", teams.robots, passive),
    }
    if others.passive:
        robots = others.passive.robots
        played[Condition.PASSIVE] = table.play("passive", robots, passive)
        played[Condition.PASSIVE_TEAM] = table.play("passive-team", robots, teams.humans)
    if others.response:
        robots = others.response.robots
        played[Condition.RESPONSE] = table.play("response", robots, teams.humans, paired=True)
    for name in ("ego", "ego_told", "ego_recurrent"):
        if egos := getattr(others, name):
            its_env = table.env(told=BOTH) if name == "ego_told" else env
            met = table.play(name, egos.robots, teams.humans, env=its_env)
            played[Condition[name.upper()]] = met.filter(~pl.col("partner").is_in(egos.met))
    for pairs, condition, its_env in (
        (others.recurrent, Condition.RECURRENT, lambda: env),
        (others.told, Condition.KNOWING, lambda: table.env(told=BOTH)),
        (others.blind, Condition.BLIND, lambda: table.env(told=())),
    ):
        if pairs:
            played[condition] = table.play(
                str(condition), pairs.robots, pairs.humans, env=its_env(), paired=True
            )
    if task in PREFERRED:
        played[Condition.MISTAKEN] = table.play(
            "mistaken", teams.robots, teams.humans, env=WrongBeliefEnv(env), paired=True
        )
    return played


@dataclasses.dataclass(frozen=True)
class _Tables:
    """Player of conditions, each into its own folder."""

    task: str
    folder: Path
    episodes: int
    seed: int
    backend: str
    version: int | None
    on_progress: Callable[[Progress], None] | None

    def env(self, **options: Any) -> Any:
        return make(self.task, self.backend, version=self.version, **options)

    def play(
        self,
        name: str,
        robots: Roster,
        humans: Roster,
        *,
        env: Any = None,
        paired: bool = False,
        times: int = 1,
    ) -> pl.DataFrame:
        """Return the episodes of robots with humans."""
        env = env or self.env()
        job = Job(
            task=self.task,
            env_version=env.version,
            backend=env.backend,
            engine=env.engine,
            egos=robots,
            partners=humans,
            episodes=times * self.episodes,
            seed=self.seed,
            paired=paired,
            own_episodes=True,
            preferences=preferences_of(self.task),
        )

        def report(state: Progress) -> None:
            if self.on_progress is not None:
                self.on_progress(dataclasses.replace(state, what=name))

        return run_job(env, job, self.folder / name, on_progress=report).table


def touches(env: Any, teams: Teams, episodes: int, seed: int) -> dict[str, float]:
    """Return forces (N) and speeds of the teams' touches, as quantiles and shares of steps."""
    forces, contacts, speeds = [], [], []
    for robot, human in zip(teams.rows("robot"), teams.rows("human"), strict=True):
        setting = str(teams.humans.members[human.id].disability)
        params = disability_params([setting] * episodes)
        force, contact, speed = _steps(env, robot, human, params, seed)
        forces.append(force)
        contacts.append(contact)
        speeds.append(speed)
    force, contact = np.concatenate(forces), np.concatenate(contacts)
    felt = force > FELT
    shares = {"contact steps": float(felt.mean())}
    if felt.any():
        below = float((contact[felt] < HARD).mean())
        quantiles = np.quantile(force[felt], (0.5, 0.95, 0.99, 1.0))
        names = ("force 50%", "force 95%", "force 99%", "force largest")
        shares |= dict(zip(names, map(float, quantiles), strict=True))
        shares["contact steps below the limit"] = below
    return shares | {"joint speed, share of the limit": float(np.concatenate(speeds).max())}


@own_settings()
def _steps(env: Any, robot: Any, human: Any, params: Any, seed: int) -> tuple[np.ndarray, ...]:
    """Return force, largest contact and fastest joint's share of its limit, [T * K] each."""
    policies = {"robot": Policy(robot.spec), "human": Policy(human.spec)}
    params_of = {"robot": robot.params, "human": human.params}
    count = params.strength.shape[0]
    limits = np.array(JOINT_SPEEDS, np.float32)[None]

    def step(carry: Any, time: jax.Array) -> Any:
        state, memory = carry
        first = jnp.full(count, time == 0)
        acted = {
            role: policy.act(params_of[role], memory[role], state.obs[role], first)
            for role, policy in policies.items()
        }
        state = env.step(state, {role: action for role, (_, action) in acted.items()})
        contact = state.measures.contact
        seen = state.measures.force, state.measures.force if contact is None else contact
        speed = (jnp.abs(state.obs["robot"][:, 7:14]) / limits).max(axis=1)
        return (state, {role: memory_after for role, (memory_after, _) in acted.items()}), (
            *seen,
            speed,
        )

    @jax.jit
    def episode() -> Any:
        state = env.reset(jax.random.split(key_of(seed), count), params)
        memory = {role: policy.initial_carry((count,)) for role, policy in policies.items()}
        return jax.lax.scan(step, (state, memory), jnp.arange(env.episode_length))[1]

    return tuple(np.asarray(values).ravel() for values in episode())


def held_roster(
    observation_size: int,
    action_size: int,
    postures: Sequence[tuple[float, ...]] = (),
) -> Roster:
    """Return humans with constant torques, shares of their strength; by default all of `HELD`."""
    postures = postures or tuple(itertools.product(HELD, repeat=action_size))
    spec = PolicySpec("human", observation_size, action_size, hidden=(1,), normalise=False)
    ids = tuple(f"held-{i}" for i in range(len(postures)))
    n = len(ids)
    params = {
        "Dense_0": {
            "kernel": np.zeros((n, observation_size, 1), np.float32),
            "bias": np.zeros((n, 1), np.float32),
        },
        "Dense_1": {
            "kernel": np.zeros((n, 1, action_size), np.float32),
            "bias": np.array(postures, np.float32),
        },
        "log_std": np.zeros((n, action_size), np.float32),
    }
    members = {name: Member(name, f"{PASSIVE}-{name}-1", disability="d1") for name in ids}
    return Roster((PolicyStack(spec, ids, params),), members)


def _next(values: jax.Array, names: Sequence[float]) -> jax.Array:
    """Return for each value [N] the following one of a cycle."""
    known = jnp.asarray(names, jnp.float32)
    place = jnp.abs(values[:, None] - known[None]).argmin(axis=1)
    return known[(place + 1) % len(names)]
