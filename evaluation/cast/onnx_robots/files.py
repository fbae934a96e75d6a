"""The files that an ONNX model is in: itself, and perhaps its weights in another one beside it.

PyTorch writes weights apart by default. They are put into the model before anything else reads it:
from then on a model is one string of bytes.
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

Files = tuple[tuple[Path, str], ...]  # each with the sha256 of what was read


def read_model(path: Path) -> tuple[bytes, Files]:
    """Return a model's bytes, all weights among them, and the files that these were in.

    Raises:
        UntrustedModelError: It is no model, or its weights are not in one regular file beside it.
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
    """Return the claims in a model's JSON metadata; empty if it is no object."""
    try:
        content = parse_json(read_metadata(data) or "{}")
    except (ValueError, RecursionError):  # of others, in a form of their own
        content = None
    return content if isinstance(content, dict) else {}


def _read_beside(path: Path, name: str) -> tuple[Path, bytes]:
    """Return the file of weights that a model names, and its bytes; it must lie beside the model.

    A link or a folder in its name could lead to any file of the reader.
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
    """Return where a tensor begins and ends in a file of weights."""
    try:
        begin = int(place.get("offset", 0))
        end = begin + int(place.get("length", size - begin))
    except ValueError:
        begin, end = 0, -1
    if not 0 <= begin <= end <= size:
        raise UntrustedModelError("malformed", "names weights beyond the end of their file")
    return begin, end
