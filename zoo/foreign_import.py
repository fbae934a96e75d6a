"""Importing a public Assistax zoo, version 1 or 2, from a folder or a `.tar.gz`; nothing in it is trusted.

| file | holds |
|---|---|
| `index.csv` | `agent_uuid, scenario, scenario_agent_id, algorithm, is_rnn, rnn_dim` |
| | version 2 also `team_uuid, w_speed, w_force, w_touch` |
| `config/<uuid>.yaml` | `ALGORITHM`, `network`, `ENV_KWARGS.disability`, `OBS_DIM`, `ACT_DIM` |
| `params/<uuid>.safetensors` | leaves named by path, joined with `/` or `,` |
"""

import csv
import dataclasses
import io
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from zoo.archive import INDEX_FILE as CSV_FILE
from zoo.archive import NAME, extract, read_member, refusal
from zoo.errors import ZooError, listing, shorten
from zoo.files import atomic_write, exclusive
from zoo.foreign import (
    FOREIGN_SCHEMA_VERSION,
    INDEX_FILE,
    ZOO_NAME,
    ForeignDisability,
    ForeignPolicy,
    ForeignZoo,
    file_record,
    foreign_root,
    params_path,
    read_zoo,
)
from zoo.schema import first_problem

V1_COLUMNS = ("agent_uuid", "scenario", "scenario_agent_id", "algorithm", "is_rnn", "rnn_dim")
V2_COLUMNS = ("team_uuid", "w_speed", "w_force", "w_touch")
MAX_POLICIES = 100_000
TASKS = {
    "scratchitch": "scratch",
    "bedbathing": "bed_bath",
    "armmanipulation": "arm_assist",
    "feeding": "feeding",
    "teethbrushing": "teeth_brushing",
}
_BOOLEANS = {
    "true": True,
    "1": True,
    "1.0": True,
    "false": False,
    "0": False,
    "0.0": False,
    "": False,
}
_NETWORK_FIELDS = (
    "recurrent",
    "agent_param_sharing",
    "activation",
    "actor_hidden_dim",
    "gru_hidden_dim",
)


@dataclasses.dataclass(frozen=True)
class Imported:
    """What an import did."""

    zoo: ForeignZoo
    folder: Path
    fresh: bool  # False: the same zoo was there already
    left_out: tuple[str, ...]  # why, for each policy that `partial` left out

    def to_json(self) -> dict[str, Any]:
        """Return the outcome as JSON-ready values."""
        noted = [
            {"uuid": policy.uuid, "notes": policy.notes}
            for policy in self.zoo.policies
            if policy.notes
        ]
        return {
            "name": self.zoo.name,
            "format": self.zoo.format,
            "folder": str(self.folder),
            "policies": len(self.zoo.policies),
            "new": self.fresh,
            "left_out": list(self.left_out),
            "noted": noted,
        }


def import_zoo(
    source: Path | str,
    name: str,
    registry: Path | str | None = None,
    *,
    partial: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Imported:
    """Import a public zoo as foreign policies beside the registry; it appears whole or not at all.

    Importing the same zoo again changes nothing.

    Args:
        source: The zoo's folder, or its `.tar.gz`.
        name: Name of the zoo in the ids of its policies, `foreign/NAME/UUID`.
        registry: The registry that it will lie beside; the path is that of `load_registry`.
        partial: Leave out what is damaged or missing, instead of refusing the zoo.
        progress: Called with the number of policies read, and of all.

    Raises:
        ForeignError: The zoo is not of a known format, unsafe, damaged, or another one has the
            name.
    """
    source, root = Path(source), foreign_root(registry)
    if not re.fullmatch(ZOO_NAME, name):
        raise refusal(
            "name of the zoo", "lower-case letters, digits, - and _, 32 at most", shorten(name)
        )
    with exclusive(root):
        _sweep(root)
        # A leading dot hides the unfinished folder from `read_foreign`.
        staging = Path(tempfile.mkdtemp(prefix=".import-", dir=root))
        try:
            folder = source
            if not source.is_dir():
                if not source.is_file():
                    raise refusal(str(source), "a zoo's folder or .tar.gz", "no such file")
                folder = staging / "unpacked"
                folder.mkdir()
                extract(source, folder)
            zoo, left_out = _stage(folder, staging / name, name, partial, progress)
            return Imported(zoo, root / name, _settle(staging / name, root / name, zoo), left_out)
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def _sweep(root: Path) -> None:
    """Remove what a killed import left; the lock says that none is running."""
    for stale in root.glob(".import-*"):
        shutil.rmtree(stale, ignore_errors=True)


def _settle(staged: Path, final: Path, zoo: ForeignZoo) -> bool:
    """Rename the staged zoo to its place; return False where the same one lies there."""
    if not final.exists():
        staged.rename(final)
        return True
    if read_zoo(final) != zoo:
        raise refusal(
            f"zoo {zoo.name}", "a new name, or the zoo that has it", f"another zoo at {final}"
        )
    return False


def _stage(
    folder: Path, staged: Path, name: str, partial: bool, progress: Callable[[int, int], None]
) -> tuple[ForeignZoo, tuple[str, ...]]:
    """Copy the zoo's parameters and write its index."""
    version, rows = _read_index(folder)
    (staged / "params").mkdir(parents=True)
    policies: dict[str, ForeignPolicy] = {}
    problems: list[str] = []
    for number, row in enumerate(rows):
        try:
            policy, data = _read_policy(folder, row, version)
            if policy.uuid in policies:
                raise refusal(
                    f"{CSV_FILE}, row {number + 1}", "each agent_uuid once", f"{policy.uuid} twice"
                )
            params_path(staged, policy).write_bytes(data)
            policies[policy.uuid] = policy
        except ZooError as error:
            problems.append(str(error))
            if not partial:
                raise
        progress(number + 1, len(rows))
    if not policies:
        raise refusal(f"{folder / CSV_FILE}", "at least one whole policy", f"none of {len(rows)}")
    zoo = ForeignZoo(
        schema_version=FOREIGN_SCHEMA_VERSION,
        name=name,
        format=version,
        policies=tuple(policies.values()),
    )
    atomic_write(staged / INDEX_FILE, zoo.model_dump_json(indent=1, exclude_defaults=True).encode())
    return zoo, tuple(problems)


def _read_index(folder: Path) -> tuple[Literal["v1", "v2"], list[dict[str, str]]]:
    data = read_member(folder, CSV_FILE)
    source = f"{CSV_FILE} of the zoo"
    try:
        reader = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        columns = [column for column in reader.fieldnames or [] if column]
        missing = [column for column in V1_COLUMNS if column not in columns]
        if missing:
            raise refusal(source, f"the columns {', '.join(V1_COLUMNS)}", f"no {listing(missing)}")
        rows = []
        for row in reader:
            rows.append(row)
            if len(rows) > MAX_POLICIES:
                raise refusal(source, f"at most {MAX_POLICIES} policies", "more")
            if None in row or None in row.values():
                raise refusal(
                    f"{source}, row {len(rows)}", f"{len(columns)} values", "another number"
                )
    except (UnicodeDecodeError, csv.Error) as error:
        raise refusal(source, "a CSV file in UTF-8", shorten(str(error))) from None
    if not rows:
        raise refusal(source, "at least one policy", "none")
    return ("v2" if all(column in columns for column in V2_COLUMNS) else "v1"), rows


def _read_policy(folder: Path, row: Mapping[str, str], version: str) -> tuple[ForeignPolicy, bytes]:
    uuid = row["agent_uuid"].strip()
    where = f"policy {shorten(uuid)} of the zoo"
    if not re.fullmatch(NAME, uuid):
        raise refusal(where, "an agent_uuid of letters, digits, - and _", shorten(uuid))
    if row["scenario"] not in TASKS:
        raise refusal(where, f"a scenario among {', '.join(TASKS)}", shorten(row["scenario"]))
    if row["is_rnn"].strip().lower() not in _BOOLEANS:
        raise refusal(where, "is_rnn True or False", shorten(row["is_rnn"]))
    config = _read_config(read_member(folder, f"config/{uuid}.yaml"), where)
    data = read_member(folder, f"params/{uuid}.safetensors")
    try:
        fields = {
            "uuid": uuid,
            "scenario": row["scenario"],
            "task": TASKS[row["scenario"]],
            "role": row["scenario_agent_id"].strip().lower(),
            "algorithm": re.sub(r"[^a-z0-9]+", "_", row["algorithm"].strip().lower()).strip("_"),
            "recurrent": _BOOLEANS[row["is_rnn"].strip().lower()],
            "disability": _disability(config),
            "network": _network(config),
            "observation_size": _size(config.get("OBS_DIM"), row["scenario_agent_id"]),
            "action_size": _size(config.get("ACT_DIM"), row["scenario_agent_id"]),
            **file_record(data, f"parameters of {where}"),
        }
        if version == "v2":
            fields["team"] = row["team_uuid"].strip() or None
            fields["reward_weights"] = {
                name: float(row[name]) for name in V2_COLUMNS[1:] if row[name].strip()
            }
        policy = ForeignPolicy.model_validate({**fields, "notes": _notes(fields)})
    except ValidationError as error:
        raise refusal(where, "the fields of a zoo", first_problem(error)) from None
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise refusal(where, "the fields of a zoo", shorten(str(error))) from None
    return policy, data


def _read_config(data: bytes, where: str) -> dict[str, Any]:
    import yaml

    class Loader(yaml.SafeLoader):
        """Without merge keys: some twenty lines of them take all memory."""

        def flatten_mapping(self, node: Any) -> None:
            if any(key.tag == "tag:yaml.org,2002:merge" for key, _ in node.value):
                raise yaml.YAMLError("merge keys are not read")

    try:
        config = yaml.load(data, Loader)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        problem = " ".join(str(error).split())
        raise refusal(f"configuration of {where}", "plain YAML", shorten(problem)) from None
    if not isinstance(config, dict):
        raise refusal(f"configuration of {where}", "a YAML mapping", type(config).__name__)
    return config


def _disability(config: Mapping[str, Any]) -> ForeignDisability | None:
    recorded = _mapping(_mapping(config.get("ENV_KWARGS")).get("disability"))
    fields: dict[str, Any] = {
        name: recorded[name] for name in ForeignDisability.model_fields if name in recorded
    }
    if isinstance(fields.get("joint_idx"), list):
        fields["joint_idx"] = tuple(fields["joint_idx"])
    return ForeignDisability.model_validate(fields) if fields else None


def _network(config: Mapping[str, Any]) -> dict[str, Any]:
    network = _mapping(config.get("network"))
    return {
        name: network[name]
        for name in _NETWORK_FIELDS
        if isinstance(network.get(name), bool | int | float | str)
    }


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _size(value: Any, agent: str) -> int | None:
    """Return a width; a configuration may hold one for each agent."""
    value = value.get(agent) if isinstance(value, Mapping) else value
    return value if type(value) is int else None


def _notes(fields: Mapping[str, Any]) -> tuple[str, ...]:
    """Say what makes the parameters unusable even for the code that wrote them."""
    leaves = fields["leaves"]
    kernel = next(
        (shape for name, shape in leaves.items() if name.endswith("Dense_0/kernel")), None
    )
    notes = []
    if kernel is None:
        notes.append("no Dense_0/kernel: not an actor that this project knows")
    elif len(kernel) != 2:
        notes.append(
            f"Dense_0/kernel has shape {list(kernel)}: one row of a shared-parameter agent's matrix"
        )
    elif fields["observation_size"] not in (None, kernel[0]):
        told = fields["observation_size"]
        notes.append(
            f"Dense_0/kernel reads {kernel[0]} observations, its configuration says {told}"
        )
    if fields["recurrent"] and not any("GRU" in name for name in leaves):
        notes.append("recurrent by its index, but without GRU parameters")
    if fields["disability"] is None:
        notes.append("its configuration records no disability")
    return tuple(notes)
