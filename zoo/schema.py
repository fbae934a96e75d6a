"""Content of `registry.json`, as frozen Pydantic models; an unknown field is an error.

Nothing is stored twice: a policy's task, algorithm, disability, seed and release are its id, its
spec is its shard's, and training provenance lies in `runs`, once for all teams of a run. Raise
`SCHEMA_VERSION` if older files would be read otherwise. Older installations refuse a new field.
"""

import dataclasses
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, PlainValidator, model_validator

from assistax_envs.disability import Disability
from population.networks.spec import PolicySpec, Role, spec_from_json
from zoo.ids import parse_team, release_number

SCHEMA_VERSION = 2

Scalar = float | int | bool | str | None
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
ReleaseName = Annotated[str, Field(pattern=r"^v(0|[1-9][0-9]{0,9})$")]
ShardPath = Annotated[
    str, Field(pattern=r"^([A-Za-z0-9_][A-Za-z0-9_.-]*/)*[A-Za-z0-9_][A-Za-z0-9_.-]*\.safetensors$")
]
Count = Annotated[int, Field(ge=0)]
Side = Annotated[str, Field(pattern=r"^(train|validation|test)$")]
Rule = Literal[
    "half",
    "leave-one-algorithm-out",
    "leave-one-disability-out",
    "small-train",
    "custom",
    "three-sides",
]
RULES: tuple[str, ...] = get_args(Rule)

Spec = Annotated[PolicySpec, PlainValidator(spec_from_json), PlainSerializer(PolicySpec.to_json)]


class StrictModel(BaseModel):
    """Frozen, of the types that it names and no other field."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class SelfPlay(StrictModel):
    """Return of a team with itself over `n` episodes, with its 95% interval."""

    mean: float
    iqm: float
    mean_ci: tuple[float, float]  # of the mean
    n: Annotated[int, Field(ge=1)]
    success: float | None = None

    @model_validator(mode="after")
    def _ordered(self) -> "SelfPlay":
        low, high = self.mean_ci
        if low > high:
            raise ValueError(f"mean_ci is [{low}, {high}]; the low end comes first")
        return self


class Training(StrictModel):
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
    notes: dict[str, Scalar] = {}  # further records of the trainer


class Citation(StrictModel):
    """The citation of a release that its makers ask for."""

    authors: Annotated[
        tuple[Annotated[str, Field(max_length=200)], ...], Field(max_length=100)
    ] = ()
    title: Annotated[str, Field(max_length=300)] = ""
    url: Annotated[str, Field(pattern=r"^(https?://[^\s{}\\]{1,300})?$")] = ""


class OwnFamily(StrictModel):
    """A family of persons that a package adds, and how many of a table's persons are of it."""

    name: Name  # of its entry point
    package: str  # distribution
    version: str
    sha256: Sha256  # of the package's files
    count: Annotated[int, Field(ge=1, le=50_000)]  # the last persons of the table


class Persons(StrictModel):
    """Persons of a task: rows of numbers that a formula gives, see `zoo.partners`."""

    program: Annotated[int, Field(ge=1)]  # version of the program that acts by a row
    count: Annotated[int, Field(ge=1, le=50_000)]
    sha256: Sha256  # of the table of rows, little-endian float32
    secret: Sha256 | None = None  # 256 bits in hex, of a season's hidden persons: gives their rows
    own: OwnFamily | None = None  # of the season's organiser


class Release(StrictModel):
    """A release: its date, the versions of its environments, its default splits, and its root."""

    date: Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
    description: str = ""
    environments: dict[Name, Annotated[int, Field(ge=1)]]
    # By task, the id of the default split; it moves to a new split when the release grows.
    splits: dict[Name, str] = {}
    persons: dict[Name, Persons] = {}  # by task
    citation: Citation | None = None
    root: Sha256 | None = None  # over all of the release, see `zoo.history.merkle`
    signature: Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")] | None = None  # Ed25519, hex


class DisabilitySetting(StrictModel):
    """A disability setting as the partners were trained with it."""

    strength: float
    elbow_range: float
    tremor: float

    @model_validator(mode="after")
    def _possible(self) -> "DisabilitySetting":
        self.value()
        return self

    def value(self) -> Disability:
        """Return the setting for a simulation; a ValueError says which number is impossible."""
        return Disability(**self.model_dump())


class Shard(StrictModel):
    """One file of stacked parameters; its bytes never change."""

    sha256: Sha256
    bytes: Count
    task: Name
    algorithm: Name
    role: Role
    release: ReleaseName
    rows: Annotated[int, Field(ge=1)]
    spec: Spec


class PolicyRow(StrictModel):
    """Where one policy's parameters lie, and the sha256 of their canonical bytes."""

    shard: ShardPath
    row: Count
    sha256: Sha256


class Team(StrictModel):
    """The policies of a team, the run that trained them, and their self-play return."""

    run: str
    self_play: SelfPlay | None = None
    policies: Annotated[dict[Role, PolicyRow], Field(min_length=1)]


class TrainedAgainst(StrictModel):
    """Split whose training side an ego met; any zoo may have published it."""

    split: str
    sha256: Sha256


class Ego(StrictModel):
    """A robot that was trained with frozen partners: no team, and never a partner."""

    run: str
    trained_against: TrainedAgainst
    policies: Annotated[dict[Literal["robot"], PolicyRow], Field(min_length=1)]


class Split(StrictModel):
    """Training, validation and test partners of a task, by team id; see `zoo.splits`."""

    id: str
    task: Name
    release: ReleaseName
    # One of `RULES`, or the word of a kind of partner that makes the split, see `zoo.partners`.
    rule: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_-]{0,31}$")]
    held_out: str | None = None
    n: int | None = None
    seed: Count
    sha256: Sha256
    train: tuple[str, ...]
    test: tuple[str, ...]
    # Side for the choice of checkpoints, seeds and hyperparameters; empty in splits of two sides.
    validation: tuple[str, ...] = ()
    # Of gentle tasks: preferences of each side's humans; empty if no preference is held out.
    preferences: dict[Side, tuple[str, ...]] = {}

    @property
    def content(self) -> dict[str, Any]:
        """Fields covered by `sha256`; empty optional fields are omitted, so hashes stay valid."""
        unused = {name for name in ("preferences", "validation") if not getattr(self, name)}
        return self.model_dump(exclude={"id", "sha256", *unused})

    @property
    def sides(self) -> dict[str, tuple[str, ...]]:
        """Teams by side, of the sides that it has."""
        optional = {"validation": self.validation} if self.validation else {}
        return {"train": self.train, **optional, "test": self.test}

    def side(self, team: str) -> str | None:
        """Return "train", "validation", "test", or None for a team outside the split."""
        return next((side for side, teams in self.sides.items() if team in teams), None)


class RegistryFile(StrictModel):
    """The whole of `registry.json`."""

    schema_version: Literal[2]
    release: ReleaseName  # the newest whole one
    releases: dict[ReleaseName, Release]
    disability_settings: dict[str, DisabilitySetting]
    runs: dict[str, Training]
    shards: dict[ShardPath, Shard]
    teams: dict[str, Team]
    egos: dict[str, Ego] = {}
    splits: tuple[Split, ...] = ()

    def release_of(self, task: str) -> ReleaseName:
        """Return a task's default release: the newest whole one that has it, else of all that do.

        Releases of an added zoo, which have a namespace, are never the default.
        """
        newest = release_number(self.release)
        having = [
            name
            for name, entry in self.releases.items()
            if ":" not in name and task in entry.environments
        ]
        return max(
            [name for name in having if release_number(name) <= newest] or having,
            key=release_number,
            default=self.release,
        )

    @model_validator(mode="after")
    def _consistent(self) -> "RegistryFile":
        _known("release", self.release, self.releases)
        for name, entry in self.members.items():
            self._check_member(name, entry)
        for split in self.splits:
            _known(f"split {split.id}: rule", split.rule, RULES)
        splits = {split.id: (split.task, split.release) for split in self.splits}
        if len(splits) != len(self.splits):
            raise ValueError("a split id occurs twice in splits")
        for name, release in self.releases.items():
            for task in release.persons:
                _known(f"releases.{name}.persons", task, release.environments)
            for task, split in release.splits.items():
                _known(f"releases.{name}.splits", split, splits)
                if splits[split] != (task, name):
                    raise ValueError(
                        f"releases.{name}.splits.{task} names {split}, a split of {splits[split]}"
                    )
        return self

    @property
    def members(self) -> dict[str, "Team | Ego"]:
        """Teams and egos by id."""
        return {**self.teams, **self.egos}

    def _check_member(self, team: str, entry: "Team | Ego") -> None:
        parts = _parse(team)
        if parts.namespace or parts.is_ego != isinstance(entry, Ego):
            raise ValueError(f"{team} is no id of {'an ego' if parts.is_ego else 'a team'} here")
        _known(f"{team}: release", parts.release, self.releases)
        _known(
            f"{team}: environment version of", parts.task, self.releases[parts.release].environments
        )
        if not parts.is_ego:
            _known(f"{team}: disability", parts.disability, self.disability_settings)
        _known(f"{team}: run", entry.run, self.runs)
        for role, place in entry.policies.items():
            _known(f"{team}/{role}: shard", place.shard, self.shards)
            shard = self.shards[place.shard]
            identity = (shard.task, shard.algorithm, shard.role, shard.release)
            if identity != (parts.task, parts.algorithm, role, parts.release):
                raise ValueError(f"{team}/{role} points to a shard of {' '.join(identity)}")
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
    disability: str  # "d3"; "ego" for a robot without a human; "own" for a body of its own
    setting: Disability | None  # numbers of "d3" in the registry
    seed: int
    release: str  # "v1"
    spec: PolicySpec  # of a partner that is no network another `SeatSpec`
    shard: str  # path relative to the registry's folder; "" if nothing is stored
    row: int
    sha256: str  # of the row's canonical bytes, or of all else that it acts by
    run: str  # key of its provenance in `runs`; "" if it was not trained
    training: Training
    self_play: SelfPlay | None
    trained_against: TrainedAgainst | None = None  # of egos

    @property
    def partner_setting(self) -> Disability:
        """The human's setting, for a simulation.

        Raises:
            ValueError: It is an ego, which has no human of its own.
        """
        if self.setting is None:
            raise ValueError(f"{self.id} is an ego; give a partner, which has a disability setting")
        return self.setting

    def brief(self) -> dict[str, Any]:
        """Return the fields that a list of policies shows, JSON-ready."""
        names = ("id", "team", "task", "algorithm", "role", "disability", "seed", "release")
        figures = self.self_play.model_dump(mode="json") if self.self_play else None
        return {**{name: getattr(self, name) for name in names}, "self_play": figures}


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
