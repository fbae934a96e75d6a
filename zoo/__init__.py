"""The published population: registry, shards, splits, remotes.

Names are loaded when first used, so importing costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zoo.added import add as add
    from zoo.added import remove as remove
    from zoo.errors import ZooError as ZooError
    from zoo.fetch import ensure_local as ensure_local
    from zoo.hub_publish import publish_to as publish_to
    from zoo.ids import PolicyId as PolicyId
    from zoo.ids import TeamId as TeamId
    from zoo.ids import parse_policy as parse_policy
    from zoo.ids import parse_team as parse_team
    from zoo.registry import Registry as Registry
    from zoo.registry import load_registry as load_registry
    from zoo.runs import TrainedTeam as TrainedTeam
    from zoo.runs import read_run as read_run
    from zoo.schema import PolicyEntry as PolicyEntry
    from zoo.schema import Split as Split
    from zoo.splits import make_split as make_split
    from zoo.storage import PolicyFile as PolicyFile
    from zoo.storage import load_stacks as load_stacks
    from zoo.storage import read_policy_file as read_policy_file
    from zoo.storage import write_policy_file as write_policy_file

_NAMES = {
    "added": ("add", "remove"),
    "errors": ("ZooError",),
    "fetch": ("ensure_local",),
    "hub_publish": ("publish_to",),
    "ids": ("PolicyId", "TeamId", "parse_policy", "parse_team"),
    "registry": ("Registry", "load_registry"),
    "runs": ("TrainedTeam", "read_run"),
    "schema": ("PolicyEntry", "Split"),
    "splits": ("make_split",),
    "storage": ("PolicyFile", "load_stacks", "read_policy_file", "write_policy_file"),
}
_HOMES = {name: f"zoo.{module}" for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(
            f"module 'zoo' has no attribute {name!r}; it offers {', '.join(sorted(_HOMES))}"
        )
    return getattr(importlib.import_module(_HOMES[name]), name)
