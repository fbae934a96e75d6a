"""Parameters as bytes: flat leaves, their canonical hash, and safetensors files without pickles."""

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import safetensors
import safetensors.numpy

from assistax_base.bounded_reading import parse_json
from assistax_base.digest import canonical_json, sha256
from assistax_base.errors import FormatError, IntegrityError, shorten
from assistax_base.files import METADATA_KEY
from population.networks import stack
from population.networks.spec import PolicySpec, spec_from_json

MAX_HEADER_BYTES = 4 * 1024 * 1024
MAX_FILE_BYTES = 4 * 1024 * 1024 * 1024
DTYPES = {"F32": np.dtype("<f4"), "F16": np.dtype("<f2")}
_LEAF = re.compile(r"[A-Za-z0-9_]{1,64}(/[A-Za-z0-9_]{1,64}){0,7}")

Leaves = dict[str, np.ndarray]


class StackedFile(NamedTuple):
    """Content of a file of stacked parameters: leaves [P, ...], and metadata of each row."""

    spec: PolicySpec
    leaves: Leaves
    rows: list[Any]
    run: str | None = None  # key of the run that wrote it


def flatten(params: Mapping[str, Any]) -> Leaves:
    """Return a nested dict's arrays by '/'-joined path, in sorted order.

    Raises:
        FormatError: A name or a value cannot be stored.
    """
    leaves = stack.flatten(params)
    _check_leaves(leaves, "parameters")
    return dict(sorted(leaves.items()))


def row_sha256(leaves: Mapping[str, np.ndarray]) -> str:
    """Return the sha256 of a policy's leaves: names, dtypes, shapes and little-endian bytes."""
    digest = hashlib.sha256()
    for name in sorted(leaves):
        value = np.ascontiguousarray(leaves[name])
        digest.update(
            f"{name}\0{value.dtype.name}\0{'x'.join(map(str, np.shape(leaves[name])))}\0".encode()
        )
        digest.update(value.astype(value.dtype.newbyteorder("<"), copy=False).data)
    return digest.hexdigest()


def published_hashes(leaves: Mapping[str, np.ndarray]) -> set[str]:
    """Return `row_sha256` of a policy's leaves in each precision in which zoos publish them.

    A policy that is published in half precision is read, and exported, as float32.
    """
    with np.errstate(over="ignore"):
        return {
            row_sha256({name: np.asarray(value, dtype) for name, value in leaves.items()})
            for dtype in DTYPES.values()
        }


def encode(leaves: Leaves, metadata: Mapping[str, Any]) -> bytes:
    """Return safetensors bytes of leaves and JSON metadata; equal input gives equal bytes."""
    _check_leaves(leaves, "parameters")
    text = canonical_json(metadata).decode()
    contiguous = {name: np.require(value, requirements="C") for name, value in leaves.items()}
    data = safetensors.numpy.save(contiguous, {METADATA_KEY: text})
    if int.from_bytes(data[:8], "little") > MAX_HEADER_BYTES:
        raise FormatError(
            "parameters", f"a header of at most {MAX_HEADER_BYTES} bytes", "a larger one"
        )
    return data


def decode(data: bytes, source: str) -> tuple[Leaves, dict[str, Any]]:
    """Return leaves and metadata of safetensors bytes.

    Raises:
        FormatError: The bytes are truncated, malformed, of another dtype, not finite, or lack the
            metadata.
    """
    header, tensors = _deserialize(data, source)
    try:
        metadata = parse_json(header["__metadata__"][METADATA_KEY])
        if not isinstance(metadata, dict):
            raise ValueError(f"metadata {METADATA_KEY!r} is not a JSON object")
    except KeyError as error:
        raise FormatError(
            source,
            f"metadata {METADATA_KEY!r}, which files of this project have",
            f"no {error}",
            "export the policy again, or write a function that loads your network",
        ) from None
    except (ValueError, TypeError, RecursionError) as error:
        raise FormatError(source, "a safetensors file", f"{shorten(str(error))}") from None
    return _leaves(tensors, source), metadata


def parse_stacked(data: bytes, source: str) -> StackedFile:
    """Return the content of stacked safetensors bytes: leaves [P, ...], metadata {"spec", "rows"}.

    Raises:
        FormatError: The file is malformed, its spec is no policy spec, or its leaves disagree on P.
    """
    leaves, metadata = decode(data, source)
    spec, rows = metadata_spec(metadata, source), metadata.get("rows")
    if not isinstance(rows, list) or not rows:
        raise FormatError(
            source, "metadata rows: a list with one item for each policy", shorten(rows)
        )
    wrong = [
        f"{name} {value.shape}" for name, value in leaves.items() if value.shape[:1] != (len(rows),)
    ]
    if wrong:
        raise FormatError(source, f"leaves with a first axis of {len(rows)}", wrong[0])
    return StackedFile(spec, leaves, rows, metadata.get("run"))


def take_row(stacked: StackedFile, row: int) -> Leaves:
    """Return one policy's leaves as stored, without the stacked axis."""
    return {name: value[row] for name, value in stacked.leaves.items()}


def metadata_spec(metadata: Mapping[str, Any], source: str) -> PolicySpec:
    """Return the policy spec of a file's metadata."""
    try:
        return spec_from_json(metadata.get("spec"))
    except ValueError as error:
        raise FormatError(source, "a policy spec in the metadata", shorten(str(error))) from None


def _deserialize(data: bytes, source: str) -> tuple[dict[str, Any], list[tuple[str, Any]]]:
    """Return the JSON header and the raw tensors of safetensors bytes; refuse a false length."""
    length = int.from_bytes(data[:8], "little")
    if len(data) < 8 or length > min(MAX_HEADER_BYTES, len(data) - 8):
        raise FormatError(
            source, "a safetensors file", f"{len(data)} bytes whose header claims {length}"
        )
    try:
        tensors = safetensors.deserialize(data)
        return parse_json(data[8 : 8 + length].decode()), tensors
    except (safetensors.SafetensorError, ValueError, TypeError, RecursionError) as error:
        raise FormatError(source, "a safetensors file", f"{shorten(str(error))}") from None


def _leaves(tensors: list[tuple[str, Any]], source: str) -> Leaves:
    """Return checked leaves by name, sorted, of raw tensors."""
    leaves = {}
    for name, tensor in tensors:
        if tensor["dtype"] not in DTYPES:
            raise FormatError(
                source, f"leaves of {' or '.join(DTYPES)}", f"{shorten(name)} of {tensor['dtype']}"
            )
        leaves[name] = np.frombuffer(tensor["data"], DTYPES[tensor["dtype"]]).reshape(
            tensor["shape"]
        )
    _check_leaves(leaves, source)
    return dict(sorted(leaves.items()))


def read_bytes(
    path: Path, source: str, *, size: int | None = None, digest: str | None = None
) -> bytes:
    """Return a file's bytes, checked against the size and sha256 of the registry.

    Raises:
        IntegrityError: The file is missing, or has another size or sha256.
    """
    if not path.is_file():
        raise IntegrityError(source, "a file", f"no file at {path}")
    length = path.stat().st_size
    if length > (MAX_FILE_BYTES if size is None else size) or (size is not None and length != size):
        raise IntegrityError(
            source,
            f"{size if size is not None else f'at most {MAX_FILE_BYTES}'} bytes",
            f"{length} bytes",
        )
    data = path.read_bytes()
    if digest is not None and sha256(data) != digest:
        raise IntegrityError(source, f"sha256 {digest}", f"sha256 {sha256(data)}")
    return data


def damaged_row(policy: str, expected: str, found: str) -> IntegrityError:
    """Return the error for a row whose bytes differ from the registry's."""
    return IntegrityError(f"parameters of {policy}", f"sha256 {expected}", f"sha256 {found}")


def _check_leaves(leaves: Mapping[str, np.ndarray], source: str) -> None:
    """Refuse leaves that are not finite floats with names that form a tree."""
    if not leaves:
        raise FormatError(source, "at least one leaf", "none")
    for name, value in leaves.items():
        if not _LEAF.fullmatch(name):
            raise FormatError(source, "leaf names like Dense_0/kernel", shorten(name))
        if value.dtype not in DTYPES.values():
            raise FormatError(source, "float32 or float16 leaves", f"{name} of {value.dtype}")
        if not np.isfinite(value).all():
            raise FormatError(source, "finite parameters", f"NaN or infinity in {name}")
    for name in leaves:
        parents = name.split("/")[:-1]
        clash = next(
            (p for i in range(len(parents)) if (p := "/".join(parents[: i + 1])) in leaves), None
        )
        if clash:
            raise FormatError(
                source, "leaves that form a tree", f"{clash} both a leaf and the parent of {name}"
            )
