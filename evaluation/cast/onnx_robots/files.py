"""Files of an ONNX model: the model, and perhaps its weights in a second file beside it.

PyTorch writes weights to a second file by default. They are merged into the model before anything
else reads it, so a model is one string of bytes from then on.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from assistax_base.bounded_reading import parse_json
from evaluation.cast.onnx_robots.ego import (
    MAX_BYTES,
    UntrustedModelError,
    parse,
    read_bytes,
    read_metadata,
)
from evaluation.record.manifest import check_regular

Files = tuple[tuple[Path, str], ...]  # paths with the sha256 of the bytes that were read


def read_model(path: Path) -> tuple[bytes, Files]:
    """Return a model's bytes with all weights merged in, and the files that were read.

    Raises:
        UntrustedModelError: The file is no model, or its weights are not in one regular file
            beside it.
        ValueError: There is no such file, or it is too large.
        ImportError: The package onnx is not installed.
    """
    import onnx

    data = read_bytes(path)
    files = ((path, hashlib.sha256(data).hexdigest()),)
    model = parse(data)
    tensors = [
        tensor
        for tensor in model.graph.initializer
        if tensor.data_location == onnx.TensorProto.EXTERNAL
    ]
    if not tensors:
        return data, files
    places = [{entry.key: entry.value for entry in tensor.external_data} for tensor in tensors]
    if len(names := {place.get("location", "") for place in places}) > 1:
        raise UntrustedModelError("external_data", "keeps weights in several other files")
    beside, weights = _read_beside(path, names.pop())
    ranges = [_range(place, len(weights)) for place in places]
    if sum(end - begin for begin, end in ranges) > MAX_BYTES:
        raise UntrustedModelError("external_data", f"names more than {MAX_BYTES} bytes of weights")
    for tensor, (begin, end) in zip(tensors, ranges, strict=True):
        tensor.ClearField("external_data")
        tensor.data_location = onnx.TensorProto.DEFAULT
        tensor.raw_data = weights[begin:end]
    return model.SerializeToString(), (*files, (beside, hashlib.sha256(weights).hexdigest()))


def read_claims(data: bytes) -> Mapping[str, Any]:
    """Return the claims in a model's JSON metadata; empty if the JSON is not an object."""
    try:
        content = parse_json(read_metadata(data) or "{}")
    except (ValueError, RecursionError):
        # Another exporter's metadata.
        content = None
    return content if isinstance(content, dict) else {}


def _read_beside(path: Path, name: str) -> tuple[Path, bytes]:
    """Return the path and bytes of the weights file that a model names, directly beside it.

    Links and folders in the name are refused: they could lead to any file on this machine.
    """
    if not name or "\\" in name or Path(name).name != name:
        raise UntrustedModelError(
            "external_data", f"keeps weights in {name[:60]!r}; only a file beside it is read"
        )
    beside = path.parent / name
    try:
        check_regular(beside.lstat())
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UntrustedModelError(
            "external_data",
            f"keeps weights in {name[:60]!r} beside it, which cannot be read ({reason}); put that "
            "file there, or save it as one file: torch.onnx.export(..., external_data=False)",
        ) from None
    return beside, read_bytes(beside)


def _range(place: Mapping[str, str], size: int) -> tuple[int, int]:
    """Return the first byte and the end of a tensor in a file of weights."""
    try:
        begin = int(place.get("offset", 0))
        end = begin + int(place.get("length", size - begin))
    except ValueError:
        begin, end = 0, -1
    if not 0 <= begin <= end <= size:
        raise UntrustedModelError("malformed", "names weights beyond the end of their file")
    return begin, end
