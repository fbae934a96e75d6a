"""Stacked shards and single-policy files: hashed by row and by file, verified on every load."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from assistax_base.digest import json_sha256
from assistax_base.errors import FormatError, IntegrityError, shorten
from assistax_base.files import atomic_write
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack, stack_policies, unflatten
from population.networks.tensors import (
    Leaves,
    StackedFile,
    damaged_row,
    decode,
    encode,
    flatten,
    metadata_spec,
    parse_stacked,
    read_bytes,
    row_sha256,
    take_row,
)
from zoo.schema import PolicyEntry

if TYPE_CHECKING:
    from zoo.registry import Registry


class PolicyFile(NamedTuple):
    """A single-policy file: leaves of `params` are float32 without the stacked axis."""

    spec: PolicySpec
    params: dict[str, Any]
    metadata: dict[str, Any]


def load_stacks(registry: "Registry", entries: Iterable[PolicyEntry]) -> tuple[PolicyStack, ...]:
    """Return the parameters of entries of all kinds, one stack for each spec: teams first."""
    return registry.stacks(entries)


def load_shards(registry: "Registry", entries: Iterable[PolicyEntry]) -> tuple[PolicyStack, ...]:
    """Return the parameters of the entries as float32, one stack for each spec, in the order asked.

    Stacks come in the order in which their specs first occur. Every shard's sha256 and every
    returned row's sha256 is held against the registry.

    Raises:
        IntegrityError: A shard is missing or its bytes are not those of the registry.
        FormatError: A shard's content contradicts the registry.
    """
    entries = list(entries)
    leaves = load_leaves(registry, entries)
    forms: dict[PolicySpec, tuple[str, dict[str, tuple[int, ...]]]] = {}
    for entry in entries:
        form = {name: value.shape for name, value in leaves[entry.id].items()}
        first, expected = forms.setdefault(entry.spec, (entry.id, form))
        if form != expected:
            raise FormatError(f"parameters of {entry.id}", f"the leaves of {first}", "others")
    return stack_policies((entry.id, entry.spec, _float32(leaves[entry.id])) for entry in entries)


def load_leaves(registry: "Registry", entries: Iterable[PolicyEntry]) -> dict[str, Leaves]:
    """Return the leaves of each entry by its id, in the dtype that is stored; verified."""
    entries = list(entries)
    shards = {path: read_shard(registry, path) for path in dict.fromkeys(e.shard for e in entries)}
    return {entry.id: _verified_row(shards[entry.shard], entry.row, entry) for entry in entries}


def read_shard(registry: "Registry", path: str) -> StackedFile:
    """Return one shard of the registry, its file verified; rows are when they are taken."""
    shard = registry.data.shards[path]
    data = read_bytes(
        registry.shard_path(path), f"shard {path}", size=shard.bytes, digest=shard.sha256
    )
    stacked = parse_stacked(data, f"shard {path}")
    if stacked.spec != shard.spec or len(stacked.rows) != shard.rows:
        found = f"{len(stacked.rows)} rows of spec {stacked.spec.digest}"
        raise FormatError(f"shard {path}", f"{shard.rows} rows of spec {shard.spec.digest}", found)
    return stacked


def read_policy_file(path: Path | str) -> PolicyFile:
    """Return the policy of a single-policy `.safetensors` file.

    Raises:
        FormatError: The file is missing, malformed, not finite, or holds no spec.
        IntegrityError: The parameters are not those that the file's own sha256 was made of.
    """
    source = f"policy file {path}"
    if not Path(path).is_file():
        raise FormatError(source, "a .safetensors file", "no such file")
    leaves, metadata = decode(read_bytes(Path(path), source), source)
    spec = metadata_spec(metadata, source)
    extra = metadata.get("metadata", {})
    if not isinstance(extra, dict):
        raise FormatError(source, "metadata that is an object", shorten(extra))
    digest = _content_sha256(spec, extra, leaves)
    if metadata.get("sha256") != digest:
        raise IntegrityError(
            source,
            f"sha256 {shorten(metadata.get('sha256'))}",
            f"sha256 {digest}",
            "fetch or export the file again; it was changed after it was written",
        )
    return PolicyFile(spec, _float32(leaves), extra)


def write_policy_file(
    path: Path | str,
    spec: PolicySpec,
    params: Mapping[str, Any],
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write one policy as `.safetensors`, atomically; see `policy_bytes`."""
    atomic_write(Path(path), policy_bytes(spec, params, metadata))


def policy_bytes(
    spec: PolicySpec, params: Mapping[str, Any], metadata: Mapping[str, Any] | None = None
) -> bytes:
    """Return one policy as the bytes of a `.safetensors` file; `metadata` is kept as JSON.

    Raises:
        FormatError: The parameters are not float32 or float16, or not finite.
    """
    leaves = flatten(params)
    extra = dict(metadata or {})
    content = {
        "spec": spec.to_json(),
        "sha256": _content_sha256(spec, extra, leaves),
        "metadata": extra,
    }
    return encode(leaves, content)


def _verified_row(stacked: StackedFile, row: int, entry: PolicyEntry) -> Leaves:
    leaves = take_row(stacked, row)
    digest = row_sha256(leaves)
    if digest != entry.sha256:
        raise damaged_row(entry.id, entry.sha256, digest)
    return leaves


def _float32(leaves: Leaves) -> dict[str, Any]:
    return unflatten({name: value.astype(np.float32, copy=False) for name, value in leaves.items()})


def _content_sha256(spec: PolicySpec, metadata: Mapping[str, Any], leaves: Leaves) -> str:
    """Return the sha256 that a policy file carries of itself: of spec, metadata and leaves."""
    return json_sha256([spec.to_json(), dict(metadata), row_sha256(leaves)], spaced=True)
