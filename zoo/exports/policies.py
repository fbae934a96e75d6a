"""One policy as a file that needs nothing of this project: safetensors, ONNX, or PyTorch."""

import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from assistax_base.digest import sha256
from assistax_base.errors import ExportError
from assistax_base.files import atomic_write
from zoo.met.published import met_in_training
from zoo.parameters.storage import load_stacks, read_policy_file
from zoo.registry import Registry

Format = Literal["safetensors", "onnx", "torch"]
_WRITERS: dict[Format, str] = {  # functions of spec, parameters and metadata; loaded when used
    "safetensors": "zoo.parameters.storage:policy_bytes",
    "onnx": "population.networks.onnx_export:to_onnx",
    "torch": "population.networks.torch_export:to_torch",
}


def export_policy(
    name: str, format: Format, out: Path, registry: Callable[[], Registry], *, force: bool = False
) -> dict[str, Any]:
    """Write one policy, deterministic and with its normaliser, and describe the file, JSON-ready.

    A file that holds the same policy is not written again.

    Args:
        name: A policy's id, or a `.safetensors` file that was exported before.
        format: Format of the file.
        out: The file.
        registry: Read when it is needed.
        force: Whether to replace a file with other content.

    Raises:
        ExportError: The file exists with other content.
        ZooError: The policy is not there, or damaged.
    """
    content = policy_file(name, format, registry)
    there = out.is_file() and out.read_bytes() == content
    if out.exists() and not there and not force:
        raise ExportError(str(out), "no file, or the same policy", "other content")
    if not there:
        atomic_write(out, content)
    facts = {"id": name, "format": format, "file": str(out), "bytes": len(content)}
    return {**facts, "sha256": sha256(content), "written": not there}


def policy_file(name: str, format: Format, registry: Callable[[], Registry]) -> bytes:
    """Return the bytes that `export_policy` writes."""
    write = pkgutil.resolve_name(_WRITERS[format])
    if name.endswith(".safetensors"):
        return write(*read_policy_file(name))
    loaded = registry()
    entry = loaded.policy(name)
    if not entry.shard:
        raise ExportError(
            name,
            "a policy with parameters",
            loaded.source_of(entry.id).without_bytes,
            "read its numbers: `assistax-zoo show`",
        )
    [stack] = load_stacks(loaded, [entry])
    met = met_in_training(loaded, entry).claim if entry.role == "robot" else {}
    metadata = {
        "id": entry.id,
        "sha256": entry.sha256,
        "disability": entry.disability,
        "env_version": loaded.env_version(entry),
        "self_play": entry.self_play.model_dump(mode="json") if entry.self_play else None,
        **met,
    }
    return write(stack.spec, stack.row(0), metadata)
