"""Republication of an earlier release's teams in a later one, with the same bytes and figures."""

from collections.abc import Iterable
from typing import Any

from assistax_envs.versions import VERSIONS
from population.networks.stack import unflatten
from population.runs.trained import TrainedTeam
from zoo.ids import TeamId
from zoo.parameters.storage import load_leaves
from zoo.registry import Registry


def republishable(
    registry: Registry, teams: Iterable[TeamId], release: str, steps: int
) -> list[TeamId]:
    """Return the teams that another release has, trained long enough in today's environments.

    Args:
        registry: The registry.
        teams: Teams of the release to be published.
        release: The earlier release.
        steps: Environment steps that a team must have been trained for.
    """
    same = []
    for team in teams:
        entry = registry.data.teams.get(str(in_release(team, release)))
        training = registry.data.runs[entry.run] if entry else None
        if training and training.steps >= steps and training.env_version == VERSIONS.get(team.task):
            same.append(team)
    return same


def read_published(registry: Registry, teams: Iterable[TeamId]) -> list[TrainedTeam]:
    """Return published teams, verified, ready to be published in another release.

    Raises:
        UnknownIdError: The registry has no such team.
        IntegrityError: A shard is missing or damaged.
    """
    teams = list(teams)
    names = {str(team): registry.team(str(team)) for team in teams}
    policies = {policy.id: policy for policy in registry.policies if policy.team in names}
    leaves = load_leaves(registry, policies.values())
    return [
        TrainedTeam(
            task=team.task,
            algorithm=team.algorithm,
            disability=team.disability,
            seed=team.seed,
            specs={role: policies[f"{team}/{role}"].spec for role in entry.policies},
            params={role: unflatten(leaves[f"{team}/{role}"]) for role in entry.policies},
            training={"run": entry.run, **_known(registry.data.runs[entry.run].model_dump())},
            self_play=_known(entry.self_play.model_dump()) if entry.self_play else None,
        )
        for team, entry in zip(teams, names.values(), strict=True)
    ]


def in_release(team: TeamId, release: str) -> TeamId:
    """Return a team's id in another release."""
    return TeamId(team.task, team.algorithm, team.disability, team.seed, release)


def _known(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that are not None."""
    return {name: value for name, value in fields.items() if value is not None}
