"""Trained teams as they come out of a run folder, before they are published.

A run folder (or its `final/`) holds `teams.json`, a list of
`{"team": {"task", "algorithm", "disability", "seed"}, "roles": {role: {"spec", "file", "row"}},
"training": {...}, "self_play": {...} | null}`, and the files it names: stacked safetensors with
leaves [P, ...] named by '/'-joined path and one metadata key `assistax` holding `{"spec": ...,
"rows": [...]}`. The folder of a `train-ego` run also holds `split.json`, the split whose training
half its partners were.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from assistax_base.bounded_reading import parse_json, read_text
from assistax_base.errors import FormatError, shorten
from assistax_base.validated import first_problem
from population.networks.spec import PolicySpec, Role
from population.networks.stack import unflatten
from zoo.parameters.storage import StackedFile, parse_stacked, take_row
from zoo.parameters.tensors import read_bytes
from zoo.schema import Split, spec_from_json
from zoo.splits import check_split

_MAX_TEAMS_BYTES = 16 * 1024 * 1024
MIXED = "mixed"  # the setting of an ego in a run folder: each of its partners has its own
_AGAIN = "give the folder that `assistax-zoo train` wrote, after the run has finished"


@dataclasses.dataclass(frozen=True)
class TrainedTeam:
    """A team ready to be published."""

    task: str
    algorithm: str
    disability: str  # "d3"
    seed: int
    specs: Mapping[Role, PolicySpec]
    params: Mapping[
        Role, Mapping[str, Any]
    ]  # nested dict of float32 or float16 arrays for each role
    training: Mapping[
        str, Any
    ]  # `run`, `steps`, `env_version`, `backend`, and what else the trainer recorded
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


def read_run(folder: Path | str) -> list[TrainedTeam]:
    """Return the teams of a run folder.

    Raises:
        FormatError: `teams.json` or a file it names is missing or malformed.
    """
    folder = Path(folder)
    home = next(
        (place for place in (folder, folder / "final") if (place / "teams.json").is_file()), None
    )
    if home is None:
        raise _error(f"run folder {folder}", "teams.json in it or in its final/", "none")
    source = str(home / "teams.json")
    items = _read_teams(home / "teams.json")
    files: dict[str, StackedFile] = {}
    against = _trained_against(home / "split.json", home.parent / "split.json")
    teams = []
    for index, item in enumerate(items):
        where = f"{source}, team {index}"
        try:
            team = _team(home, item, files, folder.resolve().name, where)
            teams.append(
                dataclasses.replace(team, trained_against=against if team.is_ego else None)
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise _error(
                where,
                "the fields that workshop/assistax_workshop/press/trained_runs.py describes",
                _reason(error),
            ) from None
    return teams


def _trained_against(*places: Path) -> dict[str, str] | None:
    """Return the split that a run names by id and sha256, if it names one."""
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return None
    try:
        split = Split.model_validate_json(
            read_text(path, _MAX_TEAMS_BYTES, FormatError, "split", _AGAIN)
        )
        check_split(split)
    except ValidationError as error:
        raise _error(str(path), "a split", first_problem(error)) from None
    return {"split": split.id, "sha256": split.sha256}


def _read_teams(path: Path) -> list[Any]:
    text = read_text(path, _MAX_TEAMS_BYTES, FormatError, "teams", _AGAIN)
    try:
        items = parse_json(text)
    except (ValueError, RecursionError) as error:
        raise _error(str(path), "a JSON list of teams", _reason(error)) from None
    if not isinstance(items, list) or not items:
        raise _error(str(path), "a JSON list of at least one team", shorten(items))
    return items


def _team(
    home: Path, item: dict, files: dict[str, StackedFile], run: str, where: str
) -> TrainedTeam:
    team = item["team"]
    specs: dict[Role, PolicySpec] = {}
    params: dict[Role, Mapping[str, Any]] = {}
    for role, place in item["roles"].items():
        stacked = _stacked(home, place["file"], files)
        specs[role] = spec_from_json(place["spec"])
        if stacked.spec != specs[role]:
            raise _error(
                where,
                f"spec {specs[role].digest} for {role}",
                f"{stacked.spec.digest} in {place['file']}",
            )
        if type(place["row"]) is not int or not 0 <= place["row"] < len(stacked.rows):
            raise _error(where, f"a row from 0 to {len(stacked.rows) - 1}", shorten(place["row"]))
        params[role] = unflatten(take_row(stacked, place["row"]))
    return TrainedTeam(
        **{name: team[name] for name in ("task", "algorithm", "disability", "seed")},
        specs=specs,
        params=params,
        training={"run": run, **item["training"]},
        self_play=_figures(item.get("self_play")),
    )


def _figures(self_play: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Return self-play figures; older runs call the interval of the mean `ci`."""
    if self_play and "ci" in self_play:
        return {("mean_ci" if name == "ci" else name): value for name, value in self_play.items()}
    return self_play


def _stacked(home: Path, name: str, files: dict[str, StackedFile]) -> StackedFile:
    if name != Path(name).name or name in ("", ".", ".."):
        raise _error(str(home), "a file name without a folder", shorten(name))
    if name not in files:
        path = home / name
        if not path.is_file():
            raise _error(str(home), f"the file {name} that teams.json names", "no such file")
        files[name] = parse_stacked(read_bytes(path, str(path)), str(path))
    return files[name]


def _reason(error: Exception) -> str:
    return f"no {error}" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"


def _error(source: str, expected: str, found: str) -> FormatError:
    return FormatError(source, expected, found, _AGAIN, "nothing was published")
