"""An opened zoo: its partners, loaded and ready to play."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from assistax_base.errors import counted
from zoo.locations import default_remote
from zoo.registry import Registry, load_registry
from zoo.schema import PolicyEntry
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import Report, remote_registry
from zoo.transport.fetch import fetch as fetch_entries
from zoo.transport.remotes import Remote

if TYPE_CHECKING:
    from evaluation.cast.partners import Partner


class Fields(TypedDict, total=False):
    """Fields by which policies are chosen: all must have the value that is given."""

    task: str
    algorithm: str
    disability: str
    role: str
    release: str


@dataclasses.dataclass(frozen=True)
class Zoo:
    """A registry of policies, and the remote from which missing ones are fetched.

    Examples:
        >>> zoo = open_zoo()
        >>> zoo.list("scratch/ippo-d1-s0")
        ['scratch/ippo-d1-s0-v1/robot', 'scratch/ippo-d1-s0-v1/human']
        >>> zoo["scratch/ppo-ego-s0"].role, len(zoo)
        ('robot', 886)
    """

    registry: Registry
    remote: Remote | None = None

    def __len__(self) -> int:
        """Return the number of policies; persons are not among them."""
        return len(self.registry.policies)

    def __iter__(self) -> Iterator[PolicyEntry]:
        """Return an iterator over the entries of all policies."""
        return iter(self.registry.policies)

    def __getitem__(self, id: str) -> PolicyEntry:
        """Return the entry of a policy or a person, as `Registry.policy` does."""
        return self.registry.policy(id)

    def select(
        self, pattern: str | Sequence[str] | None = None, **fields: Unpack[Fields]
    ) -> list[PolicyEntry]:
        """Return the entries that match.

        Args:
            pattern: Glob over ids, such as "scratch/ippo-*/human", or several; all if None.
            **fields: `task`, `algorithm`, `disability`, `role` or `release`.

        Raises:
            UnknownIdError: Nothing matches; the nearest ids are named.
        """
        return self.registry.select(pattern, **fields)

    def list(
        self, pattern: str | Sequence[str] | None = None, **fields: Unpack[Fields]
    ) -> list[str]:
        """Return the ids that match, as `select` does."""
        return [entry.id for entry in self.select(pattern, **fields)]

    def partner(self, id: str, *, role: str = "human") -> "Partner":
        """Return one policy, its bytes checked; from a remote zoo it is fetched first.

        Args:
            id: A policy's id, or its team's, whose `role` is meant.
            role: "human" or "robot".

        Raises:
            UnknownIdError: There is no such policy; the nearest ids are named.
            IntegrityError: Its bytes are not those of the registry.
            RemoteError: It is not here, and the remote does not give it.
        """
        from evaluation.cast.partners import zoo_partner

        full = id if id.endswith(("/human", "/robot")) else f"{id}/{role}"
        entry = self.registry.policy(full)
        if self.remote is not None:
            self.fetch(full)
        return zoo_partner(self.registry, entry.id, entry.role)

    def fetch(
        self,
        pattern: str | Sequence[str] | None = None,
        *,
        on_total: Callable[[int], Callable[[int], None]] = lambda total: lambda count: None,
        **fields: Unpack[Fields],
    ) -> Report:
        """Bring policies onto this machine, verified.

        Args:
            pattern: As in `select`.
            on_total: Given the bytes to come at most; returns what is called as they arrive.
            **fields: As in `select`.

        Raises:
            RemoteError: Some are missing, and there is no remote that has them.
            IntegrityError: The remote's bytes are not those of the registry.
        """
        entries = self.select(pattern, **fields)
        return fetch_entries(self.registry, entries, self.remote, on_total=on_total)

    def export(self, id: str, out: Path | str) -> Path:
        """Write one policy, deterministic and with its normaliser; return the file.

        Args:
            id: A policy's id.
            out: File to write: .safetensors, .onnx, or .pt for PyTorch.

        Raises:
            ValueError: The ending is another, or the format's package is not installed.
            ZooError: There is no such policy, or its bytes are not those of the registry.
        """
        from zoo.exports.policies import Format, export_policy

        formats: dict[str, Format] = {
            ".safetensors": "safetensors",
            ".onnx": "onnx",
            ".pt": "torch",
        }
        path = Path(out)
        if path.suffix not in formats:
            raise ValueError(f"{path.name} ends in none of {', '.join(formats)}")
        export_policy(id, formats[path.suffix], path, lambda: self.registry)
        return path

    def __repr__(self) -> str:
        return f"Zoo({str(self.registry.path)!r}, {counted(len(self.registry.policies), 'policy')})"


def open_zoo(
    source: "str | Path | Zoo | Registry | None" = None, *, accept_changes: bool = False
) -> Zoo:
    """Open a zoo.

    Args:
        source: A folder with a registry.json, that file, https://..., hf://org/name[@revision], or
            another address that fsspec knows, such as s3://bucket/zoo; None is the installed one.
        accept_changes: Go on where an address has another default split or release than when it
            was last opened.

    Raises:
        RegistryError: There is no registry, or it is of a newer schema.
        IntegrityError: Its entries are not those of its roots, or what it published before is gone.
        UpdateError: It changed what its users get by default; the error lists the changes.
        RemoteError: The remote cannot be reached.

    Examples:
        >>> zoo = open_zoo()
        >>> zoo.partner("scratch/ippo-d1-s0").spec.action_size
        3
    """
    if isinstance(source, Zoo):
        return source
    if isinstance(source, Registry):
        return Zoo(source)
    if isinstance(source, str) and "://" in source:
        remote = open_remote(source)
        return Zoo(remote_registry(remote, lambda changes: accept_changes), remote)
    if source is not None and Path(source).is_dir():
        source = Path(source) / "registry.json"
    remote = default_remote()
    return Zoo(load_registry(source), open_remote(remote) if remote else None)


def fetch(
    pattern: str | Sequence[str] | None = None,
    *,
    source: "str | Path | Zoo | None" = None,
    **fields: Unpack[Fields],
) -> Report:
    """Bring policies of a zoo onto this machine; files that are present are only verified.

    Args:
        pattern: Glob over ids, such as "scratch/ippo-*/human", or several; all if None.
        source: As in `open_zoo`.
        **fields: `task`, `algorithm`, `disability`, `role` or `release`.

    Raises:
        ZooError: See `Zoo.fetch`.

    Examples:
        >>> fetch("scratch/ippo-d1-s0").policies
        2
    """
    return open_zoo(source).fetch(pattern, **fields)
