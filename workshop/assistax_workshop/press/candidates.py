"""Team on its way into a release: its id, leaves, hashes, provenance and figures."""

import dataclasses
import json
from collections.abc import Callable, Mapping
from typing import Any, Literal

from pydantic import ValidationError

from assistax_base.errors import PublishError, listing
from assistax_base.validated import first_problem
from assistax_envs.disability import DISABILITY_SETTINGS
from population.networks.spec import PolicySpec, Role
from population.networks.tensors import Leaves, flatten, row_sha256
from population.runs.trained import TrainedTeam
from population.views import CLAIM
from zoo.ids import EGO, TeamId
from zoo.schema import Ego, PolicyRow, SelfPlay, Team, TrainedAgainst, Training

Check = Callable[[PolicySpec, Leaves, str], None]
# Fields that are part of the id, or the run's key.
_IDENTITY = ("run", "task", "algorithm", "disability", "seed", "release")


@dataclasses.dataclass(frozen=True)
class Candidate:
    """Team to publish, with the data of its registry entry."""

    team: TeamId
    specs: Mapping[Role, PolicySpec]
    leaves: Mapping[Role, Leaves]
    hashes: Mapping[Role, str]
    run: str
    training: Training
    self_play: SelfPlay | None
    trained_against: TrainedAgainst | None

    def entry(self, run: str, policies: dict[Role, PolicyRow]) -> Team | Ego:
        """Return the team's registry entry."""
        if self.trained_against is None:
            return Team(run=run, self_play=self.self_play, policies=policies)
        rows: dict[Literal["robot"], PolicyRow] = {"robot": policies["robot"]}
        return Ego(run=run, trained_against=self.trained_against, policies=rows)


def make_candidate(team: TrainedTeam, release: str, check: Check) -> Candidate:
    """Return a team as a candidate for a release.

    Raises:
        PublishError: It has no id, or lacks provenance.
        FormatError: Its parameters do not fit its spec.
    """
    name = _name(team, release)
    if team.training.get(CLAIM):
        found = "one that observes the human's preference, which no robot may observe"
        raise PublishError(f"ego {name}", "a robot that observes what robots do", found)
    leaves = {role: flatten(team.params[role]) for role in team.specs}
    for role, spec in team.specs.items():
        check(spec, leaves[role], f"parameters of {name}/{role}")
    hashes = {role: row_sha256(leaves[role]) for role in leaves}
    training = dict(team.training)
    run = str(training.get("run") or f"{team.task}-{team.algorithm}")
    try:
        provenance = Training.model_validate_json(json.dumps(_sorted_provenance(training)))
        figures = (
            SelfPlay.model_validate_json(json.dumps(team.self_play)) if team.self_play else None
        )
        against = TrainedAgainst(**team.trained_against) if team.trained_against else None
    except (ValidationError, TypeError) as error:
        problem = first_problem(error) if isinstance(error, ValidationError) else str(error)
        raise PublishError(
            f"team {name}", "provenance and figures of the schema", problem
        ) from None
    return Candidate(name, team.specs, leaves, hashes, run, provenance, figures, against)


def _name(team: TrainedTeam, release: str) -> TeamId:
    """Return the id under which a team, or a robot trained with partners, is published."""
    if team.is_ego:
        if not team.trained_against:
            missing = "none: split.json is missing (resuming the training writes it)"
            raise PublishError(
                f"ego {team.task}/{team.algorithm} seed {team.seed}",
                "the split that it was trained against",
                missing,
            )
        return TeamId(team.task, team.algorithm, EGO, team.seed, release)
    if team.disability not in DISABILITY_SETTINGS:
        label = f"disability of {team.task}/{team.algorithm} seed {team.seed}"
        raise PublishError(label, f"one of {listing(DISABILITY_SETTINGS, 12)}", team.disability)
    return TeamId(team.task, team.algorithm, team.disability, team.seed, release)


def _sorted_provenance(training: Mapping[str, Any]) -> dict[str, Any]:
    """Return the training record by the schema's fields; others are flattened into `notes`."""
    fields = Training.model_fields
    known = {name: training[name] for name in fields if training.get(name) is not None}
    rest = {name: training[name] for name in training if name not in (*fields, *_IDENTITY)}
    known["notes"] = {**known.get("notes", {}), **rest}
    for field in ("hyperparameters", "notes"):
        known[field] = dict(sorted(_scalars(known.get(field, {})).items()))
    return known


def _scalars(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested table flattened to dotted names; lists become comma-separated text."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):
            flat |= _scalars(value, f"{prefix}{name}.")
        elif isinstance(value, list | tuple):
            flat[f"{prefix}{name}"] = ",".join(map(str, value))
        else:
            flat[f"{prefix}{name}"] = value
    return flat
