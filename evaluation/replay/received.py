"""Robots of a received folder, found without running code or reading outside folder and registry.

A sender may write any name into a folder. So a name must be an id of the registry, or a policy file
in the folder itself, with the digest that the folder states. A user who trusts the folder may allow
all names, which include other paths and code to run.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_base.errors import shorten
from evaluation.cast.egos import read_egos
from evaluation.cast.robot_names import parse_reference
from evaluation.cast.roster import HostEgo, Roster
from evaluation.record.manifest import received_sha256
from zoo.registry import Registry


def received_robots(
    folder: Path,
    named: Sequence[Sequence[Any]],
    registry: Registry,
    task: str,
    *,
    run_code: bool = False,
) -> Roster:
    """Return the roster of the robots that an untrusted folder names.

    Args:
        folder: The folder.
        named: Name and digest of each robot in the identity of the folder's job.
        registry: The registry of the published robots.
        task: The robots' task.
        run_code: Allow all names: files anywhere, and Python code, which is run.

    Raises:
        ValueError: A robot is code or lies outside the folder, and that is not allowed; or it is
            not the one that played.
        ZooError: The registry has no such robot.
    """
    names = [str(row[0]) for row in named]
    sources = {name: source_of(name, folder, registry, run_code=run_code) for name in names}
    if not names:
        raise ValueError(f"{folder} names no robot that played; run again")
    if len(set(sources.values())) < len(names):
        raise ValueError(f"two robots of {folder} have files of one name; allow run_code")
    for name in names:
        _check_file(name, sources[name])
    found = read_egos([_without_patterns(source) for source in sources.values()], registry, task)
    robots = _renamed(found, {source: name for name, source in sources.items()})
    for name, digest in zip(names, (row[1] for row in named), strict=True):
        if robots.members[name].digest != digest:
            raise ValueError(
                f"robot {shorten(name)} is not the one that played in {folder}: another sha256; "
                "give the registry or the file that it was evaluated with"
            )
    return robots


def source_of(name: str, folder: Path, registry: Registry, *, run_code: bool = False) -> str:
    """Return the source behind a name: an id of the registry, or a file of the folder.

    Args:
        name: The robot's name in the folder.
        folder: The folder, not trusted.
        registry: The registry of the published robots.
        run_code: Return the name unchanged.

    Raises:
        ValueError: The name is of code or of a Python object.
        ZooError: The registry has no such robot.
    """
    if run_code:
        return name
    if name.startswith("object:"):
        raise ValueError(f"robot {shorten(name)} was a Python object, which no file holds")
    reference = parse_reference(name)
    if reference.kind == "python":
        raise ValueError(
            f"robot {shorten(name)} is code, and the folder names it; read it, then allow run_code"
        )
    if reference.kind in ("file", "onnx"):
        return str(folder.absolute() / Path(reference.source).name)
    return registry.policy(reference.source).id


def _check_file(name: str, source: str) -> None:
    """Raise a ValueError if a robot's file is missing or not a regular file."""
    reference = parse_reference(source)
    if reference.kind not in ("file", "onnx"):
        return
    try:
        received_sha256(Path(reference.source))
    except OSError as error:
        missing = f"{reference.source}: {error.strerror or error}"
        if parse_reference(name).source == reference.source:
            text = f"robot {shorten(name)} is not here ({missing}); put its file there"
        else:
            text = (
                f"robot {shorten(name)} is a file outside the folder, and the folder names it "
                f"({missing}); put a copy of it there, or allow run_code to read it where it is"
            )
        raise ValueError(text) from None


def _without_patterns(source: str) -> str | Path:
    """Return a source in a form that is not read as a glob pattern."""
    return Path(source) if parse_reference(source).kind in ("file", "onnx") else source


def _renamed(robots: Roster, names: Mapping[str, str]) -> Roster:
    """Return the roster with ids replaced by those in `names`."""

    def name_of(old: str) -> str:
        return names.get(old, old)

    stacks = [
        dataclasses.replace(stack, id=name_of(stack.id))
        if isinstance(stack, HostEgo)
        else dataclasses.replace(stack, ids=tuple(map(name_of, stack.ids)))
        for stack in robots.stacks
    ]
    members = {
        name_of(old): dataclasses.replace(member, id=name_of(old))
        for old, member in robots.members.items()
    }
    return Roster(tuple(stacks), members)
