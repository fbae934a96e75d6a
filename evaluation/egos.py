"""Find the robots that a job is about: in the registry, in files, in anybody's Python code."""

import dataclasses
import glob
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluation import onnx_admission, onnx_ego
from evaluation.policy_process import PolicyError, PolicyProcess
from evaluation.policy_reference import PolicyReference, parse_reference
from evaluation.policy_worker import told
from evaluation.provenance import file_sha256, identity_digest
from evaluation.robot_forms import as_robot
from evaluation.roster import HostEgo, Member, Roster, registry_roster
from population.spec import PolicySpec
from population.stack import PolicyStack, stack_policies
from zoo.registry import Registry
from zoo.storage import read_policy_file


class EgoError(ValueError):
    """A robot from outside failed: names the partner, the step and what was wrong."""


def read_egos(robots: Sequence[Any], registry: Registry, task: str) -> Roster:
    """Resolve references and Python objects to egos; those of one spec are stacked, in order.

    Args:
        robots: Texts of the forms of `evaluation.policy_reference`, paths, globs of policy files,
            and objects of those of `evaluation.robot_forms`.
        registry: Where ids are looked up.
        task: Whose robots are meant by a glob.

    Raises:
        ValueError: A reference has none of the known forms, or cannot play the robot.
        TypeError: An object has none of the known forms.
        ZooError: An id or a file that is not there or not what it says.
        EgoError: A robot from a Python module cannot be made.
    """
    single: list[tuple[Member, PolicySpec, Any]] = []
    host: list[tuple[Member, HostEgo]] = []
    for place, robot in enumerate(robots):
        if not isinstance(robot, str | Path):
            host.append(_from_object(robot, place))
            continue
        reference = parse_reference(str(robot))
        reference.check(task, "robot")
        if reference.kind == "zoo":
            single += _from_zoo(reference.source, registry, task)
        elif reference.kind == "file":
            single += _from_files(reference.text)
        elif reference.kind == "onnx" and (program := _program(reference)):
            single.append(program)
        elif reference.kind in ("python", "onnx"):
            host.append(_from_outside(reference))
        else:
            raise ValueError(
                f"policy {reference.text!r} is no robot to evaluate; references play it beside "
                "every robot"
            )
    stacks = stack_policies((member.id, spec, params) for member, spec, params in single)
    members = [member for member, *_ in (*single, *host)]
    egos = (ego for _, ego in host)
    return Roster((*stacks, *egos), {member.id: member for member in members})


def call_ego(
    ego: HostEgo, partners: Sequence[str], episodes: int, action_size: int
) -> Callable[[np.ndarray, int], np.ndarray]:
    """Return a function (observations [N, O], step) -> actions [N, A] that checks its answers.

    `partners` and `episodes` say who stands in each row: N is partner by partner, K episodes each.
    """
    robot = as_robot(ego.act)

    def act(obs: np.ndarray, step: int) -> np.ndarray:
        place = f"{ego.id} with {_span(partners)}, step {step}"
        try:
            if step == 0:
                robot.reset(len(obs))
            answer = robot(obs)
        except PolicyError as error:
            raise EgoError(f"{place}: {error}") from error
        except (Exception, SystemExit, GeneratorExit) as error:  # its code does not end a run
            raise EgoError(f"{place}: {told(error)}") from error
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
                f"{ego.id} with {partners[partner]}, step {step}: the action of episode "
                f"{episode} is not finite ({broken.size} of {len(obs)} rows); expected numbers in "
                "[-1, 1]"
            )
        return answer.astype(np.float32)

    return act


def _from_zoo(
    pattern: str, registry: Registry, task: str
) -> Iterable[tuple[Member, PolicySpec, Any]]:
    found = registry_roster(registry, registry.select(pattern, task=task, role="robot"))
    for stack in found.stacks:
        assert isinstance(stack, PolicyStack)
        for row, name in enumerate(stack.ids):
            yield found.members[name], stack.spec, stack.row(row)


def _from_files(text: str) -> Iterable[tuple[Member, PolicySpec, Any]]:
    """Yield the robot of a file, or of each file that a glob names, s2 before s10."""
    globbed = glob.escape(text) != text and not Path(text).exists()
    names = sorted(glob.glob(text), key=lambda name: (len(name), name)) if globbed else [text]
    if not names:
        raise ValueError(f"policy {text!r} matches no file; see what is there with ls")
    for name in names:
        spec, params, _ = read_policy_file(name)
        yield _of_file(name, Path(name)), spec, params


def _from_object(robot: Any, place: int) -> tuple[Member, HostEgo]:
    """Take a robot of this process; no digest covers what it depends on."""
    kind = getattr(robot, "__qualname__", type(robot).__qualname__)
    name = f"object:{kind}-{place}"
    return Member(name, identity_digest([name]), reusable=False), HostEgo(name, as_robot(robot))


def _program(reference: PolicyReference) -> tuple[Member, PolicySpec, Any] | None:
    """Return an ONNX file as the program that a service makes of it; None where it makes none.

    Its digest names the program too: onnxruntime, which plays the others, rounds differently.
    """
    try:
        data = onnx_ego.read_bytes(Path(reference.source))
        spec, params = onnx_admission.read_program(data)
    except (ImportError, ValueError):  # the process says in its own words what is wrong
        return None
    member = _of_file(reference.text, Path(reference.source))
    digest = identity_digest([onnx_admission.PROGRAM, member.digest])
    return dataclasses.replace(member, digest=digest), spec, params


def _from_outside(reference: PolicyReference) -> tuple[Member, HostEgo]:
    """Start the process of a robot from a Python module or an ONNX file."""
    try:
        if reference.kind == "onnx":
            path = Path(reference.source)
            robot = PolicyProcess(*onnx_ego.factory(path))
            member = _of_file(reference.text, path)
        else:
            robot = PolicyProcess(reference.source, reference.factory, reference.arguments)
            member = _python_member(reference, robot)
    except (PolicyError, OSError) as error:
        raise EgoError(f"policy {reference.text!r}: {error}") from None
    return member, HostEgo(member.id, robot)


def _python_member(reference: PolicyReference, robot: PolicyProcess) -> Member:
    """Describe a robot by all that its result is known to depend on.

    That is its code, the files that its arguments name, and those that its module declares, such as
    `DEPENDS = ["weights.pt"]`, relative to itself. Only with such a list, which may be empty, is
    the digest taken to cover everything.
    """
    folder = Path(robot.files[0]).parent
    named = [path for value in reference.arguments.values() if (path := Path(value)).is_file()]
    declared = [folder / name for name in robot.depends or ()]
    paths = [*map(Path, robot.files), *named, *declared]
    hashes = [[path.name, file_sha256(path)] for path in paths]
    return Member(
        reference.text,
        identity_digest([reference.text, hashes]),
        reusable=robot.depends is not None,
        files=tuple(paths),
    )


def _of_file(text: str, path: Path) -> Member:
    return Member(text, file_sha256(path), files=(path,))


def _span(partners: Sequence[str]) -> str:
    names = list(dict.fromkeys(partners))
    return names[0] if len(names) == 1 else f"{len(names)} partners from {names[0]} to {names[-1]}"
