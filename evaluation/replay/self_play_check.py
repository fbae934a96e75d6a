"""Check by self-play that this installation gives the returns that a registry records.

Every selected policy is loaded, its hashes checked, and stepped once; every team then plays a few
episodes with itself, all teams of a pair of specs in one stacked rollout, each under its own
disability setting.

A team passes if its mean return lies within `TEAM_MARGIN` of the recorded mean plus
`STANDARD_ERRORS` standard errors of the difference; the recorded interval gives a team's standard
deviation. A task passes if the mean difference of its teams lies within `TASK_MARGIN` and as many
standard errors. The margins allow for another physics backend: release v0 was measured on a GPU
with `mjx-warp` in float32, and `native` differs from it by 0.0 to 0.3 % on scratch.

A team that differs plays `LONGER` times as many episodes before it is reported. Among a few
episodes of hundreds of teams some fail on any installation. If a replay has more episodes than the
record, its deviation counts if it is larger: an event of one in twenty episodes may be absent from
the record.

A return is a coarse measure, because trained policies compensate: on scratch, with two episodes, a
tenth less gravity changes it by 1.6 % and a fifth less torque by 0.8 %. The golden test checks that
each step is the same.
"""

import dataclasses
import math
import platform
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from assistax_base.errors import ZooError, lacks_memory
from assistax_envs.own_settings import own_settings
from assistax_envs.versions import VERSIONS
from evaluation.cast.roster import paired_rosters
from evaluation.play.evaluator import MAX_ENVS, check_sizes
from evaluation.play.jobs import Job
from evaluation.play.runner import play
from evaluation.record.manifest import PACKAGES, installed
from population.networks.stack import PolicyStack
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry
from zoo.schema import PolicyEntry, SelfPlay

STANDARD_ERRORS = 4.0
LONGER = 16  # factor of episodes in the second replay
TEAM_MARGIN = 0.05  # of the recorded mean
TASK_MARGIN = 0.005  # of the recorded mean over a task's teams
_WIDTH_95 = 3.92  # width of a 95% interval, in standard errors

Pair = tuple[PolicyEntry, PolicyEntry]  # robot and human of a team


@dataclasses.dataclass(frozen=True)
class TeamReplay:
    """A team's recorded and replayed self-play return."""

    team: str
    expected: float | None  # recorded mean return; None if it was never measured
    found: float
    tolerance: float | None  # largest difference that passes
    episodes: int
    ok: bool


@dataclasses.dataclass(frozen=True)
class Drift:
    """Mean difference of a task's teams from their records, as a share of the recorded mean."""

    task: str
    found: float
    tolerance: float

    @property
    def ok(self) -> bool:
        """Whether the difference is within the tolerance."""
        return abs(self.found) <= self.tolerance


@dataclasses.dataclass(frozen=True)
class SelfPlayReport:
    """Result of replaying the self-play of teams."""

    backend: str
    episodes: int  # of each team in its first replay
    versions: dict[str, str]
    policies: int  # number of policies that were loaded and stepped
    # Teams of an environment version that is not playable: stepped, not replayed.
    outdated: tuple[str, ...]
    teams: tuple[TeamReplay, ...]
    drifts: tuple[Drift, ...]  # one for each task with two teams or more
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether all returns agree with their records."""
        return not self.problems

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON-ready values."""
        return {"ok": self.ok, **dataclasses.asdict(self)}


def check_self_play(
    registry: Registry,
    entries: Sequence[PolicyEntry],
    *,
    episodes: int = 4,
    backend: str = "native",
    make_env: Callable[[str, str], Any] | None = None,
    on_progress: Callable[[int], None] = lambda teams: None,
) -> SelfPlayReport:
    """Load and step every entry, replay the self-play of every complete team, return the report.

    Teams of an environment version that is not playable here are not replayed.

    Args:
        registry: The registry.
        entries: Policies of the registry.
        episodes: Episodes of each team in its first replay.
        backend: Physics backend.
        make_env: Function of task and backend that returns an environment; by default
            `assistax_envs.make`.
        on_progress: Called with the number of teams just replayed.
    """
    if episodes < 1:
        raise ValueError(f"episodes is {episodes}; give at least 1")
    from assistax_envs import make

    sound, problems = _load(registry, entries)
    steps = [problem for stack in load_stacks(registry, sound) for problem in _step_problems(stack)]
    unfit = {name for names, _ in steps for name in names}
    problems += [problem for _, problem in steps]
    outdated = {
        entry.team for entry in entries if registry.env_version(entry) != VERSIONS.get(entry.task)
    }
    teams: list[TeamReplay] = []
    for (task, version), pairs in _teams(registry, sound, unfit, outdated).items():
        env = make_env(task, backend) if make_env else make(task, backend, version=version)
        backend = env.backend
        try:
            teams += _replay(registry, env, pairs, episodes)
        except ValueError as error:
            # Policies have other sizes than the environment.
            problems.append(str(error))
        on_progress(len(pairs))
    problems += [_difference_problem(team) for team in teams if not team.ok]
    drifts = _drifts(registry, teams)
    problems += [_drift_problem(drift) for drift in drifts if not drift.ok]
    return SelfPlayReport(
        backend=backend,
        episodes=episodes,
        versions=versions(),
        policies=len(sound),
        outdated=tuple(sorted(outdated)),
        teams=tuple(teams),
        drifts=tuple(drifts),
        problems=tuple(problems),
    )


def versions() -> dict[str, str]:
    """Return the installed versions of Python and of the packages that affect returns, by name."""
    numbers = {name: installed(name) or "not installed" for name in PACKAGES}
    return {"python": platform.python_version(), **numbers}


def tolerance(recorded: SelfPlay, episodes: int, deviation: float = 0.0) -> float:
    """Return the largest difference between the recorded and a replayed mean that passes.

    Args:
        recorded: The registry's record.
        episodes: Episodes of the replay.
        deviation: Standard deviation of a return in the replay; the larger one counts.
    """
    error = _standard_error(recorded, episodes, deviation)
    return STANDARD_ERRORS * error + TEAM_MARGIN * abs(recorded.mean)


def _standard_error(recorded: SelfPlay, episodes: int, deviation: float = 0.0) -> float:
    """Return the standard error of the recorded mean minus a mean over `episodes`."""
    width = recorded.mean_ci[1] - recorded.mean_ci[0]
    deviation = max(width / _WIDTH_95 * math.sqrt(recorded.n), deviation)
    return deviation * math.sqrt(1.0 / recorded.n + 1.0 / episodes)


def _load(
    registry: Registry, entries: Sequence[PolicyEntry]
) -> tuple[list[PolicyEntry], list[str]]:
    """Return the loadable entries, and problems of the others; load shard by shard.

    So a damaged shard does not stop the check of the others.
    """
    problems: list[str] = []
    sound: list[PolicyEntry] = []
    for shard in dict.fromkeys(entry.shard for entry in entries):
        members = [entry for entry in entries if entry.shard == shard]
        try:
            load_stacks(registry, members)
            sound += members
        except ZooError as error:
            problems.append(str(error))
    return sound, problems


@own_settings()
def _step_problems(stack: PolicyStack) -> list[tuple[tuple[str, ...], str]]:
    """Return ids and problem of policies that fail on a zero observation or leave [-1, 1]."""
    import jax
    import jax.numpy as jnp

    from population.networks.policy import Policy

    policy = Policy(stack.spec)
    obs, first = jnp.zeros((2, stack.spec.observation_size)), jnp.ones(2, bool)

    def act(params: Any) -> jax.Array:
        return policy.act(params, policy.initial_carry((2,)), obs, first)[1]

    try:
        actions = np.asarray(jax.jit(lambda params: jax.lax.map(act, params))(stack.params))
    # Flax has its own exceptions for parameters of another network.
    except Exception as error:
        if lacks_memory(error):
            raise
        message = " ".join(str(error).split())[:200]
        others = f"{stack.ids[0]} and {len(stack.ids) - 1} more of its spec"
        return [(stack.ids, f"{others} cannot be stepped: {message}")]
    broken = ~(np.isfinite(actions) & (np.abs(actions) <= 1.0)).all(axis=(1, 2))
    names = [stack.ids[row] for row in np.flatnonzero(broken)]
    return [((name,), f"{name}: expected actions in [-1, 1], found others") for name in names]


def _teams(
    registry: Registry,
    entries: Sequence[PolicyEntry],
    unfit: Collection[str],
    outdated: Collection[str],
) -> dict[tuple[str, int], list[Pair]]:
    """Return the robot and human of each complete team, by task and environment version."""
    fit = {entry.id: entry for entry in entries if entry.id not in unfit}
    teams: dict[tuple[str, int], list[Pair]] = {}
    for entry in fit.values():
        human = fit.get(f"{entry.team}/human")
        if entry.role == "robot" and human and entry.team not in outdated:
            place = entry.task, registry.env_version(entry)
            teams.setdefault(place, []).append((entry, human))
    return teams


def _replay(registry: Registry, env: Any, pairs: Sequence[Pair], episodes: int) -> list[TeamReplay]:
    """Return the replays of the teams; teams that differ play a second, longer replay."""
    teams = _play(registry, env, pairs, episodes, seed=0)
    differing = {team.team for team in teams if not team.ok and team.expected is not None}
    if not differing:
        return teams
    again = [pair for pair in pairs if pair[0].team in differing]
    longer = {team.team: team for team in _play(registry, env, again, episodes * LONGER, seed=1)}
    return [longer.get(team.team, team) for team in teams]


def _play(
    registry: Registry, env: Any, pairs: Sequence[Pair], episodes: int, seed: int
) -> list[TeamReplay]:
    """Return the replays of robots with their own humans, each team with its own seeds."""
    robots, humans = paired_rosters(registry, pairs)
    job = Job(
        task=env.task,
        env_version=env.version,
        backend=env.backend,
        egos=robots,
        partners=humans,
        episodes=episodes,
        seed=seed,
        paired=True,
        own_episodes=True,
    )
    check_sizes(env, job)
    table = play(env, job, MAX_ENVS.get(env.backend, MAX_ENVS["native"]))
    returns = {
        str(team): rows["return"].to_numpy().astype(float)
        for (team,), rows in table.group_by("ego_team")
    }
    return [
        _compare(team, registry.team(team).self_play, returns[team])
        for team in (robot.team for robot, _ in pairs)
    ]


def _compare(team: str, recorded: SelfPlay | None, returns: np.ndarray) -> TeamReplay:
    mean, episodes = float(returns.mean()), len(returns)
    if recorded is None:
        return TeamReplay(team, None, mean, None, episodes, math.isfinite(mean))
    # The deviation of fewer episodes is a worse estimate than the recorded one.
    more = episodes > recorded.n
    allowed = tolerance(recorded, episodes, float(returns.std(ddof=1)) if more else 0.0)
    return TeamReplay(
        team, recorded.mean, mean, allowed, episodes, abs(mean - recorded.mean) <= allowed
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
        share = float(np.mean([team.found - recorded.mean for team, recorded in members])) / mean
        drifts.append(Drift(task, share, STANDARD_ERRORS * error / mean + TASK_MARGIN))
    return drifts


def _difference_problem(team: TeamReplay) -> str:
    if team.expected is None:
        return f"{team.team}: expected a finite self-play return, found {team.found}"
    return (
        f"{team.team}: expected a self-play return of {team.expected:.1f} within "
        f"{team.tolerance:.1f}, found {team.found:.1f} in {team.episodes} episodes; the installed "
        "physics or JAX may differ from the release's"
    )


def _drift_problem(drift: Drift) -> str:
    installed = ", ".join(f"{name} {number}" for name, number in versions().items())
    return (
        f"all teams of {drift.task}: expected their recorded returns within {drift.tolerance:.1%} "
        f"in the mean, found {drift.found:+.1%}; installed are {installed}"
    )
