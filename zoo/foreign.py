"""Foreign policies: imported from public Assistax zoos; listed, shown and verified, but never played.

They lie beside the registry, one folder for each zoo: `zoo/foreign/NAME/foreign.json` and the
parameter files as they were. Their ids are `foreign/NAME/UUID`. The registry itself does not know
them.
"""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from population.spec import Role
from zoo.archive import NAME, refusal
from zoo.errors import RegistryError, ZooError
from zoo.files import MAX_REGISTRY_BYTES, registry_path, sha256, shard_root
from zoo.schema import Count, Name, Sha256, first_problem
from zoo.selection import FOREIGN_PREFIX, refuse_unknown
from zoo.tensors import decode_foreign, read_bytes

FOLDER = "zoo/foreign"
INDEX_FILE = "foreign.json"
FOREIGN_SCHEMA_VERSION = 1
ZOO_NAME = r"[a-z0-9][a-z0-9_-]{0,31}"
_Uuid = Annotated[str, Field(pattern=rf"^{NAME}$")]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class ForeignDisability(_Model):
    """The disability that the public code was given; its factors do not mean what ours do (see docs/import.md)."""

    joint_idx: int | tuple[int, ...] | None = None
    joint_restriction_factor: float | None = None
    joint_strength: float | None = None
    tremor_magnitude: float | None = None

    @property
    def label(self) -> str:
        """Short text for the list, such as "range 0.7, strength 0.4"."""
        names = {
            "joint_restriction_factor": "range",
            "joint_strength": "strength",
            "tremor_magnitude": "tremor",
        }
        told = [
            f"{word} {value:g}"
            for field, word in names.items()
            if (value := getattr(self, field)) is not None
        ]
        return ", ".join(told) or "none"


class ForeignPolicy(_Model):
    """One policy of a foreign zoo: what its index row and its configuration say, and the bytes of its parameters."""

    uuid: _Uuid
    team: _Uuid | None = None  # version 2 only
    scenario: str  # "scratchitch"
    task: Name  # ours that is nearest: "scratch"
    role: Role
    algorithm: Name
    recurrent: bool
    disability: ForeignDisability | None  # None: its configuration records none
    network: dict[str, float | int | bool | str | None]
    observation_size: int | None = None
    action_size: int | None = None
    reward_weights: dict[str, float] = {}  # version 2 only
    bytes: Count
    sha256: Sha256  # of the parameter file
    leaves: dict[str, tuple[int, ...]]  # shapes by name
    notes: tuple[str, ...] = ()  # what looks wrong with it


class ForeignZoo(_Model):
    """The whole of a `foreign.json`."""

    schema_version: Literal[1]
    name: Annotated[str, Field(pattern=rf"^{ZOO_NAME}$")]
    format: Literal["v1", "v2"]
    policies: tuple[ForeignPolicy, ...]

    @model_validator(mode="after")
    def _unique(self) -> "ForeignZoo":
        if len({policy.uuid for policy in self.policies}) != len(self.policies):
            raise ValueError("a uuid stands twice in policies")
        return self


@dataclasses.dataclass(frozen=True)
class ForeignEntry:
    """A foreign policy with the fields that selection reads."""

    id: str  # "foreign/public/1f0c..."
    team: str  # "foreign/public/TEAM_UUID", or the id where the zoo has no teams
    zoo: str
    format: str
    policy: ForeignPolicy
    path: Path

    release = "foreign"

    @property
    def task(self) -> str:
        """Our task that its scenario comes nearest to."""
        return self.policy.task

    @property
    def algorithm(self) -> str:
        """Algorithm as its index names it, in lower case."""
        return self.policy.algorithm

    @property
    def role(self) -> str:
        """Seat it was trained in."""
        return self.policy.role

    @property
    def disability(self) -> str:
        """Disability as its configuration records it."""
        return self.policy.disability.label if self.policy.disability else "not recorded"

    def to_json(self) -> dict[str, Any]:
        """Return everything known of the policy as JSON-ready values."""
        head = {
            "id": self.id,
            "team": self.team,
            "foreign": True,
            "zoo": self.zoo,
            "format": self.format,
        }
        return {
            **head,
            **self.policy.model_dump(mode="json", exclude={"team"}),
            "file": str(self.path),
        }


def foreign_root(path: Path | str | None = None) -> Path:
    """Return the folder of the foreign zoos that belong to a registry; the path is that of `load_registry`."""
    return shard_root(registry_path(path)) / FOLDER


def read_foreign(path: Path | str | None = None) -> list[ForeignEntry]:
    """Return the foreign policies that lie beside a registry, by zoo and index order; none is an empty list.

    Raises:
        RegistryError: A `foreign.json` is damaged or of a newer schema.
    """
    root = foreign_root(path)
    folders = sorted(root.glob(f"[a-z0-9]*/{INDEX_FILE}")) if root.is_dir() else []
    return [entry for index in folders for entry in _entries(index.parent, read_zoo(index.parent))]


def read_zoo(folder: Path) -> ForeignZoo:
    """Return the validated index of one foreign zoo."""
    index = folder / INDEX_FILE
    try:
        if index.stat().st_size > MAX_REGISTRY_BYTES:
            raise ValueError(f"more than {MAX_REGISTRY_BYTES} bytes")
        zoo = ForeignZoo.model_validate_json(index.read_bytes())
        if zoo.name != folder.name:
            raise ValueError(f"name {zoo.name}, not that of its folder")
        return zoo
    except (ValidationError, OSError, ValueError) as error:
        found = first_problem(error) if isinstance(error, ValidationError) else str(error)
        raise RegistryError(
            f"foreign zoo {index}",
            expected=f"an index of schema version {FOREIGN_SCHEMA_VERSION}",
            found=found,
            done="nothing was loaded",
            next_step=f"remove the folder {folder} and import the zoo again",
        ) from None


def find_foreign(policy_id: str, path: Path | str | None = None) -> ForeignEntry:
    """Return one foreign policy by its id.

    Raises:
        UnknownIdError: There is none of that id; the nearest ids are named.
    """
    entries = {entry.id: entry for entry in read_foreign(path)}
    if policy_id not in entries:
        # Its prefix would make the general error speak of playing it.
        refuse_unknown(policy_id.removeprefix(FOREIGN_PREFIX), list(entries), "foreign policy")
    return entries[policy_id]


def foreign_problems(
    path: Path | str | None = None, progress: Callable[[str], None] = lambda zoo: None
) -> tuple[int, list[str]]:
    """Hold every foreign parameter file against its recorded sha256 and shapes; return their number and problems."""
    try:
        entries = read_foreign(path)
    except ZooError as error:
        return 0, [str(error)]
    for zoo in dict.fromkeys(entry.zoo for entry in entries):
        progress(f"{FOREIGN_PREFIX}{zoo}")
    return len(entries), [problem for entry in entries for problem in _problems(entry)]


def _problems(entry: ForeignEntry) -> Iterator[str]:
    try:
        data = read_bytes(
            entry.path,
            f"parameters of {entry.id}",
            size=entry.policy.bytes,
            digest=entry.policy.sha256,
        )
        if shapes(data, entry.id) != entry.policy.leaves:
            yield str(refusal(entry.id, "the shapes of its index", "others"))
    except ZooError as error:
        yield str(error)


def shapes(data: bytes, source: str) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a foreign parameter file by leaf name."""
    return {name: tuple(value.shape) for name, value in decode_foreign(data, source).items()}


def params_path(folder: Path, policy: ForeignPolicy) -> Path:
    """Return where a zoo's folder keeps a policy's parameters: content decides the name."""
    return folder / "params" / f"{policy.uuid}.safetensors"


def file_record(data: bytes, source: str) -> dict[str, Any]:
    """Return what the index keeps of a parameter file."""
    return {"bytes": len(data), "sha256": sha256(data), "leaves": shapes(data, source)}


def _entries(folder: Path, zoo: ForeignZoo) -> Iterator[ForeignEntry]:
    for policy in zoo.policies:
        name = f"{FOREIGN_PREFIX}{zoo.name}/{policy.uuid}"
        team = f"{FOREIGN_PREFIX}{zoo.name}/{policy.team}" if policy.team else name
        yield ForeignEntry(name, team, zoo.name, zoo.format, policy, params_path(folder, policy))
