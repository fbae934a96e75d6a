"""Find the policies that a job is about: from the registry, from a file, or from anybody's Python code."""

import hashlib
import importlib
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.jobs import Ego, Group, HostEgo, Member
from population.spec import PolicySpec
from zoo.registry import Registry
from zoo.schema import PolicyEntry
from zoo.storage import load_stacks, read_policy_file

FORMS = "zoo:ID, a path to a .safetensors file, onnx:FILE, or python:package.module:factory"


class EgoError(ValueError):
    """A robot from outside failed: names the partner, the step and what was wrong."""


def read_egos(references: Sequence[str], registry: Registry, task: str) -> tuple[Ego, ...]:
    """Resolve `--policy` references to egos; several of one spec are stacked, in the order given.

    Raises:
        ValueError: a reference has none of the known forms, or is given twice.
        ZooError: an id or a file that is not there or not what it says.
        EgoError: the factory of a Python reference cannot be imported or fails.
    """
    single: list[tuple[PolicySpec, Member, Any]] = []
    host: list[HostEgo] = []
    for reference in references:
        scheme, _, rest = reference.partition(":")
        if scheme == "python":
            host.append(_from_python(reference, rest))
        elif scheme == "zoo":
            for group in registry_groups(registry, registry.select(rest, task=task, role="robot")):
                single += [
                    (group.spec, member, _row(group.params, row))
                    for row, member in enumerate(group.members)
                ]
        elif scheme == "onnx":
            host.append(_from_onnx(reference, rest))
        elif reference.endswith(".safetensors"):
            single.append(_from_file(reference))
        else:
            raise ValueError(f"policy {reference!r} has an unknown form; allowed are {FORMS}")
    return (*_stack(single), *host)


def registry_groups(registry: Registry, entries: Sequence[PolicyEntry]) -> tuple[Group, ...]:
    """Load registry policies, hashes checked, as groups of one spec."""
    by_id = {entry.id: entry for entry in entries}
    return tuple(
        Group(group.spec, tuple(_member(by_id[name]) for name in group.ids), group.params)
        for group in load_stacks(registry, entries)
    )


def call_ego(
    ego: HostEgo, partners: Sequence[str], episodes: int, action_size: int
) -> Callable[[np.ndarray, int], np.ndarray]:
    """Return a function (observations [N, O], step) -> actions [N, A] that checks what the ego's code answers.

    `partners` and `episodes` say who stands in each row: N is partner by partner, K episodes each.
    """

    def act(obs: np.ndarray, step: int) -> np.ndarray:
        place = f"{ego.member.id} with {_span(partners)}, step {step}"
        try:
            if step == 0 and callable(reset := getattr(ego.act, "reset", None)):
                reset(len(obs))
            answer = ego.act(obs)
            answer = np.asarray(answer.detach().cpu() if hasattr(answer, "detach") else answer)
        except Exception as error:
            raise EgoError(f"{place}: {_told(error)}") from error
        if answer.shape != (len(obs), action_size) or answer.dtype.kind not in "fiu":
            raise EgoError(
                f"{place}: returned {answer.dtype} of shape {answer.shape}; expected floats of "
                f"shape {(len(obs), action_size)}: one action in [-1, 1] for each row of "
                "observations"
            )
        broken = np.flatnonzero(~np.isfinite(answer).all(axis=1))
        if broken.size:
            partner, episode = divmod(int(broken[0]), episodes)
            raise EgoError(
                f"{ego.member.id} with {partners[partner]}, step {step}: the action of episode "
                f"{episode} is not finite ({broken.size} of {len(obs)} rows); expected numbers in "
                "[-1, 1]"
            )
        return answer.astype(np.float32)

    return act


def _from_python(reference: str, rest: str) -> HostEgo:
    module_name, _, factory_name = rest.partition(":")
    if not module_name or not factory_name:
        raise ValueError(
            f"policy {reference!r} lacks a part; expected python:package.module:factory"
        )
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        raise EgoError(
            f"policy {reference!r}: cannot import {module_name}: {_told(error)}"
        ) from error
    factory = getattr(module, factory_name, None)
    if not callable(factory):
        raise EgoError(
            f"policy {reference!r}: {module_name} has no function {factory_name!r}; name the ego's "
            "factory"
        )
    try:
        act = factory()
    except Exception as error:
        raise EgoError(f"policy {reference!r}: {factory_name}() failed: {_told(error)}") from error
    if not callable(act):
        raise EgoError(
            f"policy {reference!r}: {factory_name}() returned {type(act).__name__}; expected a "
            "callable"
        )
    return HostEgo(Member(reference, _source_digest(module, reference)), act)


def _from_onnx(reference: str, rest: str) -> HostEgo:
    from evaluation.onnx_ego import OnnxEgo

    act = OnnxEgo(Path(rest), reference)
    return HostEgo(Member(reference, act.digest), act)


def _from_file(reference: str) -> tuple[PolicySpec, Member, Any]:
    path = Path(reference)
    spec, params, _ = read_policy_file(path)
    return spec, Member(reference, hashlib.sha256(path.read_bytes()).hexdigest()), params


def _member(entry: PolicyEntry) -> Member:
    return Member(
        entry.id,
        entry.sha256,
        entry.team,
        entry.algorithm,
        entry.disability,
        entry.seed,
        entry.setting,
    )


def _stack(single: Sequence[tuple[PolicySpec, Member, Any]]) -> tuple[Group, ...]:
    groups = []
    for spec in dict.fromkeys(spec for spec, _, _ in single):
        members = tuple(member for other, member, _ in single if other == spec)
        groups.append(
            Group(
                spec,
                members,
                _stack_trees([params for other, _, params in single if other == spec]),
            )
        )
    return tuple(groups)


def _stack_trees(trees: Sequence[Any]) -> Any:
    if isinstance(trees[0], dict):
        return {name: _stack_trees([tree[name] for tree in trees]) for name in trees[0]}
    return np.stack([np.asarray(leaf) for leaf in trees])


def _row(params: Any, row: int) -> Any:
    return (
        {name: _row(leaf, row) for name, leaf in params.items()}
        if isinstance(params, dict)
        else params[row]
    )


def _source_digest(module: Any, reference: str) -> str:
    source = inspect.getsourcefile(module)
    content = Path(source).read_bytes() if source else b""
    return hashlib.sha256(reference.encode() + b"\0" + content).hexdigest()


def _told(error: Exception) -> str:
    """Say an exception in one line, with the place in the user's code."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    message = " ".join(str(error).split())
    return (
        f"{type(error).__name__}: {message}{place}" if message else f"{type(error).__name__}{place}"
    )


def _span(partners: Sequence[str]) -> str:
    names = list(dict.fromkeys(partners))
    return names[0] if len(names) == 1 else f"{len(names)} partners from {names[0]} to {names[-1]}"
