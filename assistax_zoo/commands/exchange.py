"""Commands that bring policies in and out: export; and what `show --card` and `verify --deep` do."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from assistax_zoo.console import print_json, progress, stdout_is_data

if TYPE_CHECKING:
    from evaluation.deep import DeepReport
    from zoo.registry import Registry

FormatName = Literal["safetensors", "onnx", "torch"]


def export(
    id: str,
    *,
    format: FormatName,
    out: Path,
    registry: Path | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Write one policy to a file that needs nothing of this project: safetensors, ONNX, or a PyTorch state dict.

    The file holds the deterministic policy, its observation normaliser included. See
    docs/export.md.

    Args:
        id: A policy's id, or a .safetensors file that was exported before.
        format: Format of the file.
        out: File to write.
        registry: Registry to read instead of the installed one.
        force: Replace the file if it exists.
        json: Print JSON.

    Example:
        assistax-zoo export scratch/ippo-d3-s5-v1/robot --format onnx --out robot.onnx
    """
    from zoo.files import atomic_write, sha256

    if out.exists() and not force:
        raise ValueError(
            f"{out} exists; nothing was written: choose another --out, or give --force to replace "
            "it"
        )
    with stdout_is_data():
        spec, params, metadata = _read_policy(id, registry)
        if format == "onnx":
            from population.onnx_export import to_onnx

            atomic_write(out, to_onnx(spec, params, metadata))
        elif format == "torch":
            from population.torch_export import to_torch

            atomic_write(out, to_torch(spec, params, metadata))
        else:
            from zoo.storage import write_policy_file

            write_policy_file(out, spec, params, metadata)
    data = out.read_bytes()
    if json:
        print_json(
            {"id": id, "format": format, "file": out, "bytes": len(data), "sha256": sha256(data)}
        )
    else:
        print(f"wrote {id} as {format} to {out} ({len(data)} bytes)")


def write_card(cards: Sequence[dict[str, Any]], path: Path, image: Path | None) -> None:
    """Write a card as Markdown; a picture stands in it relative to the card."""
    import os

    from zoo.card import markdown_card
    from zoo.files import atomic_write

    if image is not None and not image.is_file():
        raise ValueError(
            f"no picture at {image}; render one with `assistax-zoo render`, or leave --image out"
        )
    place = (
        None
        if image is None
        else Path(os.path.relpath(image.resolve(), path.resolve().parent)).as_posix()
    )
    atomic_write(path, markdown_card(cards, place).encode())


def replay_teams(
    registry: "Registry", pattern: str | None, release: str | None, episodes: int, backend: str
) -> "DeepReport":
    """Run `verify --deep`: progress on standard error, nothing on standard output."""
    from evaluation.deep import verify_deep

    entries = registry.select(pattern, release=release)
    with (
        stdout_is_data(),
        progress("replay teams", len({entry.team for entry in entries})) as advance,
    ):
        return verify_deep(
            registry, entries, episodes=episodes, backend=backend, on_progress=advance
        )


def print_replay(result: "DeepReport") -> None:
    """Print expected and found returns of each team, the versions, and a verdict."""
    print(", ".join(f"{name} {version}" for name, version in result.versions.items()))
    for team in result.teams:
        expected = (
            "not recorded"
            if team.expected is None
            else f"{team.expected:.1f} within {team.tolerance:.1f}"
        )
        found = f"{team.found:.1f}" + (
            f" in {team.episodes} episodes" if team.episodes > result.episodes else ""
        )
        print(
            f"{'ok     ' if team.ok else 'differs'} {team.team:28} expected {expected}, found "
            f"{found}"
        )
    for problem in result.problems:
        print(f"problem: {problem}")
    if result.outdated:
        print(
            "not replayed, trained on another version of the environment: "
            f"{', '.join(result.outdated)}"
        )
    for drift in result.drifts:
        print(f"{drift.task}: mean difference {drift.found:+.2%}, allowed {drift.tolerance:.2%}")
    print(
        f"{'replayed' if result.ok else f'{len(result.problems)} problems in'} {len(result.teams)} "
        f"teams of {result.episodes} episodes on {result.backend}, {result.policies} policies "
        "stepped"
    )


def _read_policy(id: str, registry: Path | None) -> tuple[Any, Any, dict[str, Any]]:
    """Return spec, parameters and metadata of a policy of the registry or of a file."""
    from zoo.registry import load_registry
    from zoo.storage import load_stacks, read_policy_file

    if id.endswith(".safetensors"):
        return read_policy_file(id)
    loaded = load_registry(registry)
    entry = loaded.policy(id)
    (group,) = load_stacks(loaded, [entry])
    metadata = {
        "id": entry.id,
        "sha256": entry.sha256,
        "disability": entry.disability,
        "env_version": loaded.env_version(entry),
        "self_play": entry.self_play.model_dump(mode="json") if entry.self_play else None,
    }
    return group.spec, group.row(0), metadata
