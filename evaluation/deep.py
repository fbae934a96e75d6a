"""Replaying self-play: does this installation give the returns that a registry records?

Every selected policy is loaded, its hashes checked, and stepped once; every team then plays a few
episodes with itself, all teams of a pair of specs in one stacked rollout, each under its own
disability setting.

A team passes if its mean return lies within `TEAM_MARGIN` of the recorded mean plus
`STANDARD_ERRORS` standard errors of the difference; the recorded interval gives a team's standard
deviation. A task passes if the mean difference of its teams lies within `TASK_MARGIN` and as many
standard errors. The margins allow for another physics
backend: release v0 was measured on a GPU with `mjx-warp` in float32, and `native` differs from it
    by 0.0 to 0.3 % on
scratch.

A team that differs plays `LONGER` times as many episodes before it is called different: among the
few episodes of each of hundreds of teams some fail, which says nothing of the installation.

A return is a coarse measure, since trained policies make up for much: on scratch, with two
episodes, a tenth less gravity moves it by 1.6 % and a fifth less torque by 0.8 %. That each step is
the same is what the golden test checks.
"""

import dataclasses
import math
import sys
from collections.abc import Callable, Collection, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from assistax_envs.versions import VERSIONS
from population.stack import PolicyStack
from zoo.errors import ZooError
from zoo.registry import Registry
from zoo.schema import PolicyEntry, SelfPlay
from zoo.storage import load_stacks

STANDARD_ERRORS = 4.0
LONGER = 16  # times the episodes
TEAM_MARGIN = 0.05  # of the recorded mean
TASK_MARGIN = 0.005  # of the recorded mean over a task's teams
PACKAGES = ("assistax-zoo", "mujoco", "mujoco-mjx", "jax", "jaxlib", "flax", "numpy")
_WIDTH_95 = 3.92  # of a 95% interval, in standard errors


@dataclasses.dataclass(frozen=True)
class TeamReplay:
    """What a team was recorded with, and what it did here."""

    team: str
    expected: float | None  # recorded mean return; None if it was never measured
    found: float
    tolerance: float | None  # largest difference that passes
    episodes: int
    ok: bool


@dataclasses.dataclass(frozen=True)
class Drift:
    """Mean difference of a task's teams from their recorded returns, as a share of the recorded mean."""

    task: str
    found: float
    tolerance: float

    @property
    def ok(self) -> bool:
        """Whether it lies within what is allowed."""
        return abs(self.found) <= self.tolerance


@dataclasses.dataclass(frozen=True)
class DeepReport:
    """What `verify --deep` found."""

    backend: str
    episodes: int  # of each team, but for those that played longer
    versions: dict[str, str]
    policies: int  # loaded and stepped
    outdated: tuple[
        str, ...
    ]  # teams trained on another version of the environment: stepped, not replayed
    teams: tuple[TeamReplay, ...]
    drifts: tuple[Drift, ...]  # one for each task with two teams or more
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing differs from what is recorded."""
        return not self.problems

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON-ready values."""
        return {"ok": self.ok, **dataclasses.asdict(self)}


def verify_deep(
    registry: Registry,
    entries: Sequence[PolicyEntry],
    *,
    episodes: int = 4,
    backend: str = "native",
    seed: int = 0,
    make_env: Callable[[str, str], Any] | None = None,
    on_progress: Callable[[int], None] = lambda teams: None,
) -> DeepReport:
    """Load and step every entry, and replay the self-play of every team that is whole among them.

    Teams of another version of the environment are not replayed: the installed one is not what
    their returns are of.

    Args:
        registry: The registry.
        entries: Policies of it.
        episodes: Episodes of each team at first.
        backend: Physics backend.
        seed: Seed of the episodes.
        make_env: From task and backend to an environment; default `assistax_envs.make`.
        on_progress: Called with the number of teams just replayed.
    """
    if episodes < 1:
        raise ValueError(f"episodes is {episodes}; give at least 1 (--episodes 4)")
    from assistax_envs import make

    groups, problems = _load(registry, entries)
    steps = {group.ids: _step_problems(group) for group in groups}
    problems += [problem for found in steps.values() for problem in found]
    outdated = {
        entry.team for entry in entries if registry.env_version(entry) != VERSIONS.get(entry.task)
    }
    teams: list[TeamReplay] = []
    for task, pairs in _team_blocks(
        [group for group in groups if not steps[group.ids]], outdated
    ).items():
        env = (make_env or make)(task, backend)
        backend = env.backend
        for robots, humans in pairs:
            misfit = _misfit(env, robots, humans)
            problems += [misfit] if misfit else []
            teams += [] if misfit else _replay(registry, env, robots, humans, episodes, seed)
            on_progress(len(robots.ids))
    problems += [_difference(team) for team in teams if not team.ok]
    drifts = _drifts(registry, teams)
    problems += [_drifted(drift) for drift in drifts if not drift.ok]
    return DeepReport(
        backend=backend,
        episodes=episodes,
        versions=versions(),
        policies=sum(len(group.ids) for group in groups),
        outdated=tuple(sorted(outdated)),
        teams=tuple(teams),
        drifts=tuple(drifts),
        problems=tuple(problems),
    )


def versions() -> dict[str, str]:
    """Return the installed versions that decide what a policy does, Python's included."""
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def tolerance(recorded: SelfPlay, episodes: int) -> float:
    """Return the largest difference between the recorded and a replayed mean that passes."""
    return STANDARD_ERRORS * _standard_error(recorded, episodes) + TEAM_MARGIN * abs(recorded.mean)


def _standard_error(recorded: SelfPlay, episodes: int) -> float:
    """Return that of the difference between the recorded mean and one over `episodes`."""
    deviation = (recorded.mean_ci[1] - recorded.mean_ci[0]) / _WIDTH_95 * math.sqrt(recorded.n)
    return deviation * math.sqrt(1.0 / recorded.n + 1.0 / episodes)


def _load(
    registry: Registry, entries: Sequence[PolicyEntry]
) -> tuple[list[PolicyStack], list[str]]:
    """Load shard by shard, so that a damaged one leaves the others to be replayed; groups are of one task."""
    problems: list[str] = []
    sound: set[str] = set()
    for shard in dict.fromkeys(entry.shard for entry in entries):
        members = [entry for entry in entries if entry.shard == shard]
        try:
            load_stacks(registry, members)
            sound |= {entry.id for entry in members}
        except ZooError as error:
            problems.append(str(error))
    kept = [entry for entry in entries if entry.id in sound]
    tasks = dict.fromkeys(entry.task for entry in kept)
    return [
        g for task in tasks for g in load_stacks(registry, [e for e in kept if e.task == task])
    ], problems


def _step_problems(group: PolicyStack) -> list[str]:
    """Step every policy once from a zero observation; name those that fail or leave the action's range."""
    import jax
    import jax.numpy as jnp

    from population.policy import Policy

    policy = Policy(group.spec)
    obs, first = jnp.zeros((2, group.spec.observation_size)), jnp.ones(2, bool)

    def act(params: Any) -> jax.Array:
        return policy.act(params, policy.initial_carry((2,)), obs, first)[1]

    try:
        actions = np.asarray(jax.jit(lambda params: jax.lax.map(act, params))(group.params))
    except Exception as error:  # flax has exceptions of its own for parameters of another network
        message = " ".join(str(error).split())[:200]
        return [
            f"{group.ids[0]} and {len(group.ids) - 1} more of its spec cannot be stepped: {message}"
        ]
    broken = ~(np.isfinite(actions) & (np.abs(actions) <= 1.0)).all(axis=(1, 2))
    return [
        f"{group.ids[row]}: expected actions in [-1, 1], found others"
        for row in np.flatnonzero(broken)
    ]


def _team_blocks(
    groups: Sequence[PolicyStack], without: Collection[str]
) -> dict[str, list[tuple[PolicyStack, PolicyStack]]]:
    """Return, by task, the whole teams of each pair of specs: robots and humans in the same order."""
    home = {
        name: index
        for index, group in enumerate(groups)
        for name in group.ids
        if name.rpartition("/")[0] not in without
    }
    members: dict[tuple[str, int, int], list[str]] = {}
    for name, index in home.items():
        team, _, role = name.rpartition("/")
        if role == "robot" and f"{team}/human" in home:
            members.setdefault((team.partition("/")[0], index, home[f"{team}/human"]), []).append(
                team
            )
    blocks: dict[str, list[tuple[PolicyStack, PolicyStack]]] = {}
    for (task, robots, humans), teams in members.items():
        pair = (_take(groups[robots], teams, "robot"), _take(groups[humans], teams, "human"))
        blocks.setdefault(task, []).append(pair)
    return blocks


def _take(group: PolicyStack, teams: Sequence[str], role: str) -> PolicyStack:
    return group.take([group.ids.index(f"{team}/{role}") for team in teams])


def _misfit(env: Any, *groups: PolicyStack) -> str | None:
    """Say which policies read or act in other widths than the environment has."""
    for group in groups:
        role, found = group.spec.role, (group.spec.observation_size, group.spec.action_size)
        expected = (env.observation_size[role], env.action_size[role])
        if found != expected:
            return f"{group.ids[0]}: expected observation and action sizes {expected} of {env.task}, found {found}"
    return None


def _replay(
    registry: Registry, env: Any, robots: PolicyStack, humans: PolicyStack, episodes: int, seed: int
) -> list[TeamReplay]:
    """Play the teams, and those that differ once more and for longer."""
    teams = _play(registry, env, robots, humans, episodes, seed)
    differing = [team.team for team in teams if not team.ok and team.expected is not None]
    if not differing:
        return teams
    groups = (_take(group, differing, group.spec.role) for group in (robots, humans))
    longer = {
        team.team: team for team in _play(registry, env, *groups, episodes * LONGER, seed + 1)
    }
    return [longer.get(team.team, team) for team in teams]


def _play(
    registry: Registry, env: Any, robots: PolicyStack, humans: PolicyStack, episodes: int, seed: int
) -> list[TeamReplay]:
    import jax

    from assistax_envs import disability_params
    from population.policy import Policy
    from population.self_play import self_play

    groups = {"robot": robots, "human": humans}
    figures = self_play(
        env,
        {role: Policy(group.spec) for role, group in groups.items()},
        {role: dict(group.params) for role, group in groups.items()},
        disability_params([registry.policy(name).partner_setting for name in humans.ids]),
        jax.random.split(jax.random.key(seed), len(robots.ids)),
        episodes,
    )
    teams = [name.rpartition("/")[0] for name in robots.ids]
    return [
        _compare(team, registry.team(team).self_play, float(found["mean"]), episodes)
        for team, found in zip(teams, figures, strict=True)
    ]


def _compare(team: str, recorded: SelfPlay | None, found: float, episodes: int) -> TeamReplay:
    if recorded is None:
        return TeamReplay(team, None, found, None, episodes, math.isfinite(found))
    allowed = tolerance(recorded, episodes)
    return TeamReplay(
        team, recorded.mean, found, allowed, episodes, abs(found - recorded.mean) <= allowed
    )


def _drifts(registry: Registry, teams: Sequence[TeamReplay]) -> list[Drift]:
    drifts = []
    for task in dict.fromkeys(team.team.partition("/")[0] for team in teams):
        members = [
            (team, recorded)
            for team in teams
            if team.team.startswith(f"{task}/") and (recorded := registry.team(team.team).self_play)
        ]
        mean = abs(float(np.mean([recorded.mean for _, recorded in members]))) if members else 0.0
        if len(members) < 2 or mean == 0.0:
            continue
        errors = [_standard_error(recorded, team.episodes) for team, recorded in members]
        error = math.sqrt(sum(error**2 for error in errors)) / len(members)
        found = float(np.mean([team.found - recorded.mean for team, recorded in members])) / mean
        drifts.append(Drift(task, found, STANDARD_ERRORS * error / mean + TASK_MARGIN))
    return drifts


def _difference(team: TeamReplay) -> str:
    if team.expected is None:
        return f"{team.team}: expected a finite self-play return, found {team.found}"
    return (
        f"{team.team}: expected a self-play return of {team.expected:.1f} within "
        f"{team.tolerance:.1f}, found {team.found:.1f} in {team.episodes} episodes; the installed "
        "physics or JAX may differ from the release's"
    )


def _drifted(drift: Drift) -> str:
    installed = ", ".join(f"{name} {number}" for name, number in versions().items())
    return (
        f"all teams of {drift.task}: expected their recorded returns within {drift.tolerance:.1%} "
        f"in the mean, found {drift.found:+.1%}; installed are {installed}"
    )
