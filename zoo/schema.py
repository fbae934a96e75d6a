"""What `registry.json` holds, as frozen Pydantic models; an unknown field or a newer schema is an error.

Nothing is stored twice: a policy's task, algorithm, disability, seed and release are its id, its
spec is its shard's, and training provenance lies in `runs`, once for all teams of a run. Raise
`SCHEMA_VERSION` with every added field, since older installations refuse what they do not know.
"""

import dataclasses
import json
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
    model_validator,
)

from assistax_envs.disability import Disability
from population.spec import PolicySpec, Role
from zoo.ids import parse_team

SCHEMA_VERSION = 1

Scalar = float | int | bool | str | None
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
ReleaseName = Annotated[str, Field(pattern=r"^v(0|[1-9][0-9]{0,9})$")]
ShardPath = Annotated[
    str, Field(pattern=r"^([A-Za-z0-9_][A-Za-z0-9_.-]*/)*[A-Za-z0-9_][A-Za-z0-9_.-]*\.safetensors$")
]
Count = Annotated[int, Field(ge=0)]


def spec_from_json(value: object) -> PolicySpec:
    """Return the spec that `PolicySpec.to_json` wrote.

    Raises:
        ValueError: A field is missing, unknown, or of another type.
    """
    if isinstance(value, PolicySpec):
        return value
    if not isinstance(value, dict):
        raise ValueError(f"a policy spec is an object, not {type(value).__name__}")
    try:
        spec = PolicySpec(**value)
    except TypeError as error:
        raise ValueError(f"policy spec: {error}") from None
    if json.dumps(spec.to_json(), sort_keys=True) != json.dumps(
        {**spec.to_json(), **value}, sort_keys=True
    ):
        raise ValueError("policy spec: a field has another type than PolicySpec gives it")
    numbers = (spec.observation_size, spec.action_size, *spec.hidden)
    if any(type(number) is not int for number in numbers) or type(spec.normalise) is not bool:
        raise ValueError("policy spec: sizes are whole numbers and normalise is true or false")
    return spec


Spec = Annotated[PolicySpec, PlainValidator(spec_from_json), PlainSerializer(PolicySpec.to_json)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class SelfPlay(_Model):
    """Return of a team with itself over `n` episodes, with its 95% interval."""

    mean: float
    iqm: float
    ci: tuple[float, float]
    n: Annotated[int, Field(ge=1)]
    success: float | None = None

    @model_validator(mode="after")
    def _ordered(self) -> "SelfPlay":
        if self.ci[0] > self.ci[1]:
            raise ValueError(f"ci is [{self.ci[0]}, {self.ci[1]}]; the low end comes first")
        return self


class Training(_Model):
    """How a run was trained; all its teams share it."""

    steps: Count  # environment steps of each seed
    env_version: Annotated[int, Field(ge=1)]
    backend: str  # "mjx-warp"
    date: str | None = None  # ISO date
    commit: str | None = None
    device: str | None = None
    seconds: float | None = None
    versions: dict[str, str] = {}  # of jax, mujoco, ...
    hyperparameters: dict[str, Scalar] = {}
    notes: dict[str, Scalar] = {}  # whatever else the trainer recorded


class Release(_Model):
    """A release: its date, the environment versions its policies were trained on, and its default splits."""

    date: Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
    description: str = ""
    environments: dict[Name, Annotated[int, Field(ge=1)]]
    splits: dict[
        Name, str
    ] = {}  # task -> id of its default split; moves to a new split when the release grows


class DisabilitySetting(_Model):
    """A disability setting as the partners were trained with it."""

    strength: float
    elbow_range: float
    tremor: float

    @model_validator(mode="after")
    def _possible(self) -> "DisabilitySetting":
        self.value()
        return self

    def value(self) -> Disability:
        """Return it as what a simulation takes.

        Raises:
            ValueError: A number is none that a human can have.
        """
        return Disability(**self.model_dump())


class Shard(_Model):
    """One file of stacked parameters; its bytes never change."""

    sha256: Sha256
    bytes: Count
    task: Name
    algorithm: Name
    role: Role
    release: ReleaseName
    rows: Annotated[int, Field(ge=1)]
    spec: Spec


class PolicyRow(_Model):
    """Where one policy's parameters lie, and the sha256 of their canonical bytes."""

    shard: ShardPath
    row: Count
    sha256: Sha256


class Team(_Model):
    """The policies of a team, the run that trained them, and their self-play return."""

    run: str
    self_play: SelfPlay | None = None
    policies: Annotated[dict[Role, PolicyRow], Field(min_length=1)]


class Split(_Model):
    """Training and test partners of a task, by team id; see `zoo.splits`."""

    id: str
    task: Name
    release: ReleaseName
    rule: str
    held_out: str | None = None
    n: int | None = None
    seed: Count
    sha256: Sha256
    train: tuple[str, ...]
    test: tuple[str, ...]

    def side(self, team: str) -> str | None:
        """Return "train", "test", or None for a team outside the split."""
        return "train" if team in self.train else "test" if team in self.test else None


class RegistryFile(_Model):
    """The whole of `registry.json`."""

    schema_version: int
    release: ReleaseName  # the newest whole one: its splits are the default
    releases: dict[ReleaseName, Release]
    disability_settings: dict[str, DisabilitySetting]
    runs: dict[str, Training]
    shards: dict[ShardPath, Shard]
    teams: dict[str, Team]
    splits: tuple[Split, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> "RegistryFile":
        if self.schema_version != SCHEMA_VERSION:
            raise ValueError(f"schema_version is {self.schema_version}, not {SCHEMA_VERSION}")
        _known("release", self.release, self.releases)
        for team, entry in self.teams.items():
            self._check_team(team, entry)
        splits = {split.id: (split.task, split.release) for split in self.splits}
        if len(splits) != len(self.splits):
            raise ValueError("a split id stands twice in splits")
        for name, release in self.releases.items():
            for task, split in release.splits.items():
                _known(f"releases.{name}.splits", split, splits)
                if splits[split] != (task, name):
                    raise ValueError(
                        f"releases.{name}.splits.{task} names {split}, a split of {splits[split]}"
                    )
        return self

    def _check_team(self, team: str, entry: Team) -> None:
        parts = _parse(team)
        _known(f"{team}: release", parts.release, self.releases)
        _known(
            f"{team}: environment version of", parts.task, self.releases[parts.release].environments
        )
        _known(f"{team}: disability", parts.disability, self.disability_settings)
        _known(f"{team}: run", entry.run, self.runs)
        for role, place in entry.policies.items():
            _known(f"{team}/{role}: shard", place.shard, self.shards)
            shard = self.shards[place.shard]
            found = (shard.task, shard.algorithm, shard.role, shard.release)
            if found != (parts.task, parts.algorithm, role, parts.release):
                raise ValueError(f"{team}/{role} points to a shard of {' '.join(found)}")
            if place.row >= shard.rows:
                raise ValueError(
                    f"{team}/{role} is row {place.row} of a shard with {shard.rows} rows"
                )


@dataclasses.dataclass(frozen=True, slots=True)
class PolicyEntry:
    """One published policy, with all that the registry knows of it."""

    id: str  # "scratch/ippo-d3-s5-v1/human"
    team: str  # "scratch/ippo-d3-s5-v1"
    task: str
    algorithm: str
    role: Role
    disability: str  # "d3"
    setting: Disability  # what "d3" is, as the registry has it
    seed: int
    release: str  # "v1"
    spec: PolicySpec
    shard: str  # path relative to the registry's folder
    row: int
    sha256: str  # of the row's canonical bytes
    run: str  # key of its provenance in `runs`
    training: Training
    self_play: SelfPlay | None


def dump_registry(file: RegistryFile) -> str:
    """Return the registry's text: sorted, and one line for each small object, so that changes give small diffs."""
    data = file.model_dump(mode="json", exclude_defaults=True)
    data["teams"] = {
        team: data["teams"][team]
        for team in sorted(data["teams"], key=lambda text: _parse(text).order)
    }
    for table in ("releases", "runs", "shards"):
        data[table] = dict(sorted(data[table].items()))
    data["splits"] = sorted(data.get("splits", []), key=lambda split: split["id"])
    return _lay_out(data, 0) + "\n"


def first_problem(error: ValidationError) -> str:
    """Return the first problem that validation found, where it is, and how many more there are."""
    problems = error.errors(include_url=False, include_input=False)
    where = ".".join(map(str, problems[0]["loc"])) or "the file"
    kind, message = problems[0]["type"], problems[0]["msg"]
    what = "unknown field" if kind == "extra_forbidden" else message.removeprefix("Value error, ")
    more = f" and {len(problems) - 1} more problems" if len(problems) > 1 else ""
    return f"{what} at {where[:200]}{more}"


def _parse(team: str) -> Any:
    try:
        return parse_team(team)
    except Exception as error:  # Pydantic collects ValueErrors only
        raise ValueError(str(error)) from None


def _known(what: str, name: str, table: Any) -> None:
    if name not in table:
        raise ValueError(
            f"{what} {name!r} is not among {', '.join(map(str, table)) or 'none'}"[:300]
        )


def _lay_out(value: Any, indent: int, width: int = 190) -> str:
    """Return JSON with a container on one line where it fits and holds no deep nesting, else one item a line."""
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if (
        not isinstance(value, dict | list)
        or not value
        or (indent and _shallow(value) and len(flat) + indent <= width)
    ):
        return flat
    inner = " " * (indent + 1)
    if isinstance(value, list):
        items = [inner + _lay_out(item, indent + 1) for item in value]
    else:
        items = [
            f"{inner}{json.dumps(key)}: {_lay_out(item, indent + 1)}" for key, item in value.items()
        ]
    opening, closing = ("[", "]") if isinstance(value, list) else ("{", "}")
    return opening + "\n" + ",\n".join(items) + "\n" + " " * indent + closing


def _shallow(value: Any) -> bool:
    """Return whether a container holds scalars only, or one short list as well."""
    items = value.values() if isinstance(value, dict) else value
    return all(
        not isinstance(item, dict) and (not isinstance(item, list) or len(item) <= 4)
        for item in items
    )
