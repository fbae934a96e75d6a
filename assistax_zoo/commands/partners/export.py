"""The command that takes a policy away: export."""

from pathlib import Path

from assistax_zoo.shell.console import answer, stdout_is_data
from zoo.exports.policies import Format, export_policy
from zoo.registry import load_registry


def export(
    id: str,
    *,
    format: Format,
    out: Path,
    registry: Path | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Write one policy to a file that needs nothing of this project: safetensors, ONNX, PyTorch.

    The file holds the deterministic policy, its observation normaliser included. See
    docs/export.md.

    Args:
        id: A policy's id, or a .safetensors file that was exported before.
        format: Format of the file.
        out: File to write.
        registry: Registry to read instead of the installed one.
        force: Replace the file if it exists with other content.
        json: Print JSON.

    Example:
        assistax-zoo export scratch/ippo-d3-s5-v1/robot --format onnx --out robot.onnx
    """
    with stdout_is_data():
        done = export_policy(id, format, out, lambda: load_registry(registry), force=force)
    deed = "wrote" if done["written"] else "nothing to do:"
    answer(json, done, f"{deed} {id} as {format} to {out} ({done['bytes']} bytes)")
