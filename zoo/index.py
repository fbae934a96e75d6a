"""The registry's table of policies, read without its schema: enough to list a thousand policies at once.

Only what is printed is read and checked; whatever looks wrong goes to `zoo.registry.load_registry`,
which says why.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

from zoo.errors import ZooError
from zoo.files import read_registry_text, registry_path
from zoo.ids import parse_team

_SCHEMA_VERSION = 1  # the one whose layout is read here


@dataclasses.dataclass(frozen=True, slots=True)
class IndexEntry:
    """One line of the list; the fields are those of `zoo.registry.PolicyEntry`."""

    id: str
    team: str
    task: str
    algorithm: str
    role: str
    disability: str
    seed: int
    release: str
    self_play: dict[str, Any] | None

    def to_json(self) -> dict[str, Any]:
        """Return the entry as JSON-ready values."""
        return dataclasses.asdict(self)


def read_index(path: Path | str | None = None) -> list[IndexEntry]:
    """Return the policies of the registry in its order; the path is that of `load_registry`.

    Raises:
        RegistryError: The file is missing or is not of the schema.
    """
    found = registry_path(path)
    try:
        data = json.loads(read_registry_text(found))
        if data["schema_version"] == _SCHEMA_VERSION:
            return _entries(data["teams"])
    except (ZooError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    from zoo.registry import load_registry

    return [_from_policy(entry) for entry in load_registry(found).policies]


def _entries(teams: dict[str, Any]) -> list[IndexEntry]:
    parsed = sorted(
        ((parse_team(name), entry) for name, entry in teams.items()), key=lambda pair: pair[0].order
    )
    return [
        IndexEntry(
            id=str(team.policy(role)),
            team=str(team),
            task=team.task,
            algorithm=team.algorithm,
            role=role,
            disability=team.disability,
            seed=team.seed,
            release=team.release,
            self_play=_figures(entry.get("self_play")),
        )
        for team, entry in parsed
        for role in sorted(entry["policies"], reverse=True)
    ]


def _figures(value: Any) -> dict[str, Any] | None:
    """Return self-play figures; their absence or misshape raises, and the whole registry is then validated."""
    if value is None:
        return None
    low, high = value["ci"]
    figures = {"mean": value["mean"], "iqm": value["iqm"], "ci": [low, high], "n": value["n"]}
    figures["success"] = value.get("success")
    if not all(
        isinstance(number, int | float)
        for number in (low, high, *list(figures.values())[:2], figures["n"])
    ):
        raise TypeError("self_play")
    return figures


def _from_policy(entry: Any) -> IndexEntry:
    fields: dict[str, Any] = {
        field.name: getattr(entry, field.name) for field in dataclasses.fields(IndexEntry)
    }
    fields["self_play"] = entry.self_play.model_dump(mode="json") if entry.self_play else None
    return IndexEntry(**fields)
