"""Reader of a finished run's folder, which may come from elsewhere and is checked.

A run folder (or its `final/`) holds `teams.json`, a list of
`{"team": {"task", "algorithm", "disability", "seed"}, "roles": {role: {"spec", "file", "row"}},
"training": {...}, "self_play": {...} | null}`, and the files it names: stacked safetensors with
leaves [P, ...] named by '/'-joined path, whose metadata is `{"spec": ..., "rows": [...]}`.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from assistax_base.errors import FormatError, shorten
from population.config import MIXED, TrainConfig
from population.networks.spec import PolicySpec, Role, spec_from_json
from population.networks.stack import PolicyStack, stack_policies, unflatten
from population.networks.tensors import StackedFile, parse_stacked, read_bytes, take_row
from population.runs.folder import DONE, REMEDY, RunFolder


@dataclasses.dataclass(frozen=True)
class TrainedTeam:
    """Team that a run trained, or an ego."""

    task: str
    algorithm: str
    disability: str  # "d3"; MIXED for an ego
    seed: int
    specs: Mapping[Role, PolicySpec]
    # Nested dict of float32 or float16 arrays for each role.
    params: Mapping[Role, Mapping[str, Any]]
    # `steps`, `env_version`, `backend` and more that the trainer recorded; `run` if published.
    training: Mapping[str, Any]
    self_play: Mapping[str, Any] | None = None  # mean, iqm, mean_ci, n, and success if known
    trained_against: Mapping[str, str] | None = None  # an ego's split and its sha256

    def __post_init__(self) -> None:
        if not self.specs or set(self.specs) != set(self.params):
            raise ValueError(
                f"specs are for {sorted(self.specs)}, params for {sorted(self.params)}; give both "
                "by role"
            )
        for role, spec in self.specs.items():
            if spec.role != role:
                raise ValueError(f"the spec under role {role!r} is of role {spec.role!r}")

    @property
    def is_ego(self) -> bool:
        """Whether it is a robot alone, trained with partners of several disability settings."""
        return self.disability == MIXED and set(self.specs) == {"robot"}


@dataclasses.dataclass(frozen=True)
class TrainedRun:
    """Result of a run; figures and policies are in the order of `config.members`."""

    folder: Path
    config: TrainConfig
    training: Mapping[str, Any]  # steps, seconds, device, versions and more that was recorded
    # `mean`, `iqm`, `mean_ci`, `n` and `success` of each team; None for egos, and if left out.
    self_play: tuple[Mapping[str, Any] | None, ...]
    policies: Mapping[str, PolicyStack]  # by role; ids are "NAME/ROLE"

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each member, "task/algorithm-setting-sN"."""
        return self.config.names


def read_trained_run(folder: Path | str) -> TrainedRun:
    """Return the finished run of a folder, its policies stacked by role.

    Raises:
        FormatError: The run is not finished, or a file is malformed.
    """
    config, teams = RunFolder(folder).config(), read_teams(folder)
    policies = {}
    for role in teams[0].specs:
        members = zip(config.names, teams, strict=True)
        policies[role], *_ = stack_policies(
            (f"{name}/{role}", team.specs[role], team.params[role]) for name, team in members
        )
    figures = tuple(team.self_play for team in teams)
    return TrainedRun(Path(folder), config, teams[0].training, figures, policies)


def read_teams(folder: Path | str) -> list[TrainedTeam]:
    """Return the teams of a run folder.

    Raises:
        FormatError: `teams.json` or a file it names is missing or malformed.
    """
    run = RunFolder(teams_folder(folder))
    files: dict[str, StackedFile] = {}
    teams = []
    for index, item in enumerate(run.team_items()):
        where = f"{run.teams}, team {index}"
        try:
            teams.append(_team(run.folder, item, files, where))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            reason = (
                f"no {error}" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
            )
            raise _error(where, f"the fields that {__name__} describes", reason) from None
    return teams


def teams_folder(folder: Path | str) -> Path:
    """Return the folder of a run's `teams.json`: the run folder, or its `final/`.

    Raises:
        FormatError: Neither has the file.
    """
    for place in (Path(folder), Path(folder) / "final"):
        if (place / "teams.json").is_file():
            return place
    raise _error(f"run folder {folder}", "teams.json in it or in its final/", "none")


def _team(
    folder: Path, item: dict[str, Any], files: dict[str, StackedFile], where: str
) -> TrainedTeam:
    """Return one team of `teams.json`, with the parameters of its roles."""
    team = item["team"]
    specs: dict[Role, PolicySpec] = {}
    params: dict[Role, Mapping[str, Any]] = {}
    for role, location in item["roles"].items():
        stacked = _stacked(folder, location["file"], files)
        specs[role] = spec_from_json(location["spec"])
        if stacked.spec != specs[role]:
            raise _error(
                where,
                f"spec {specs[role].digest} for {role}",
                f"{stacked.spec.digest} in {location['file']}",
            )
        if stacked.run != item.get("run"):
            raise _error(where, "parameters of its own run", f"another run's in {location['file']}")
        if type(location["row"]) is not int or not 0 <= location["row"] < len(stacked.rows):
            raise _error(
                where, f"a row from 0 to {len(stacked.rows) - 1}", shorten(location["row"])
            )
        params[role] = unflatten(take_row(stacked, location["row"]))
    return TrainedTeam(
        **{name: team[name] for name in ("task", "algorithm", "disability", "seed")},
        specs=specs,
        params=params,
        training={**item["training"]},
        self_play=item.get("self_play"),
    )


def _stacked(home: Path, name: str, files: dict[str, StackedFile]) -> StackedFile:
    """Return the content of a stacked file, read once; `files` caches it by name."""
    if name != Path(name).name or name in ("", ".", ".."):
        raise _error(str(home), "a file name without a folder", shorten(name))
    if name not in files:
        path = home / name
        if not path.is_file():
            raise _error(str(home), f"the file {name} that teams.json names", "no such file")
        files[name] = parse_stacked(read_bytes(path, str(path)), str(path))
    return files[name]


def _error(source: str, expected: str, found: str) -> FormatError:
    return FormatError(source, expected, found, REMEDY, DONE)
