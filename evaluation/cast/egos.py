"""Find the robots that a job is about: in the registry, in files, in anybody's Python code."""

import dataclasses
import glob
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from evaluation.cast.onnx_robots import admission
from evaluation.cast.onnx_robots import ego as onnx_ego
from evaluation.cast.onnx_robots.ego import UntrustedModelError
from evaluation.cast.onnx_robots.files import Files, read_claims, read_model
from evaluation.cast.policy_process import PolicyError, PolicyProcess
from evaluation.cast.policy_worker import error_text
from evaluation.cast.robot_names import PolicyReference, parse_reference
from evaluation.cast.roster import HostEgo, Member, Roster, registry_roster
from evaluation.record.manifest import file_sha256, identity_digest
from population.networks.seat import Seat
from population.networks.stack import stack_policies
from population.networks.tensors import flatten, row_sha256
from zoo.met.claims import claimed_met, claimed_version, declared_met
from zoo.met.published import NOT_KNOWN, Met, met_in_training
from zoo.parameters.storage import read_policy_file
from zoo.registry import Registry
from zoo.schema import PolicyEntry


class EgoError(ValueError):
    """A robot from outside failed: names the partner, the step and what was wrong."""


def read_egos(robots: Sequence[Any], registry: Registry, task: str) -> Roster:
    """Resolve references and Python objects to egos; those of one spec are stacked, in order.

    Args:
        robots: Texts of the forms of `evaluation.cast.robot_names`, paths, globs of policy files,
            and objects of those of `evaluation.cast.robot_forms`.
        registry: Where ids are looked up.
        task: Whose robots are meant by a glob.

    Raises:
        ValueError: A reference has none of the known forms, or cannot play the robot.
        TypeError: An object has none of the known forms.
        ZooError: An id or a file that is not there or not what it says.
        EgoError: A robot from a Python module cannot be made.
    """
    single: list[tuple[Member, Seat, Any]] = []
    host: list[tuple[Member, HostEgo]] = []
    for place, robot in enumerate(robots):
        if not isinstance(robot, str | Path):
            host.append(_from_object(robot, place, registry))
            continue
        reference = parse_reference(str(robot))
        reference.check(task, "robot")
        if reference.kind == "zoo":
            single += _from_zoo(reference.source, registry, task)
        elif reference.kind == "file":
            single += _from_files(reference.text, registry, isinstance(robot, str))
        elif reference.kind == "onnx":
            member, seat, params = _from_onnx(reference, registry)
            if isinstance(seat, HostEgo):
                host.append((member, seat))
            else:
                single.append((member, seat, params))
        elif reference.kind == "python":
            host.append(_from_code(reference, registry, task))
        else:
            raise ValueError(
                f"policy {reference.text!r} is not a robot to evaluate; every evaluation plays it "
                "as a reference"
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
    robot = ego.act

    def act(obs: np.ndarray, step: int) -> np.ndarray:
        place = f"{ego.id} with {_span(partners)}, step {step}"
        try:
            if step == 0:
                robot.reset(len(obs))
            answer = robot(obs)
        except PolicyError as error:
            raise EgoError(f"{place}: {error}") from error
        except (Exception, SystemExit, GeneratorExit) as error:  # its code does not end a run
            raise EgoError(f"{place}: {error_text(error)}") from error
        if problem := _problem(answer, (len(obs), action_size)):
            raise EgoError(f"{place}: {problem}")
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


class Clipping:
    """Lets a robot from outside act, and counts what the environment will clip.

    Args:
        act: Of `call_ego`.
        length: Steps of an episode.
    """

    def __init__(self, act: Callable[[np.ndarray, int], np.ndarray], length: int) -> None:
        self._act, self._length = act, length
        self._beyond: list[np.ndarray] = []  # at each place of a series: sum over steps [N]

    def __call__(self, obs: Float[np.ndarray, "N O"], step: int) -> Float[np.ndarray, "N A"]:
        """Return the actions at a step of the series."""
        action = self._act(obs, step)
        if step % self._length == 0:
            self._beyond.append(np.zeros(len(obs)))
        self._beyond[-1] += (np.abs(action) > 1.0).mean(axis=1)
        return action

    def shares(self, shape: tuple[int, ...]) -> Float[np.ndarray, "E P K"]:
        """Return the share of numbers beyond [-1, 1] of each episode [E, P, K]."""
        return (np.stack(self._beyond, axis=-1) / self._length).reshape(shape)


def probe_egos(roster: Roster, task: str, observation_size: int, action_size: int) -> None:
    """Let every robot from outside answer two rows of zeros, before programs are compiled for it.

    Raises:
        EgoError: It failed, or answered with another number of actions.
    """
    for ego in roster.hosts:
        robot, obs = ego.act, np.zeros((2, observation_size), np.float32)
        try:
            with robot.playing():
                robot.reset(len(obs))
                problem = _problem(robot(obs), (len(obs), action_size))
                robot.reset(len(obs))
        except PolicyError as error:
            problem = f"failed: {error}"
        except (Exception, SystemExit, GeneratorExit) as error:  # its code does not end a run
            problem = f"failed: {error_text(error)}"
        if problem:
            raise EgoError(
                f"{ego.id} cannot play: given two rows of zeros it {problem}; the robot of task "
                f"{task} reads observations [N, {observation_size}] and gives actions "
                f"[N, {action_size}]"
            )


def _problem(answer: np.ndarray, shape: tuple[int, ...]) -> str:
    """Say what is wrong with a robot's answer; empty if nothing is."""
    if answer.shape == shape and answer.dtype.kind in "fiu":
        return ""
    return (
        f"returned {answer.dtype} of shape {answer.shape}; expected floats of shape {shape}: one "
        "action in [-1, 1] for each row of observations"
    )


def _from_zoo(pattern: str, registry: Registry, task: str) -> Iterable[tuple[Member, Seat, Any]]:
    robots = registry_roster(registry, registry.select(pattern, task=task, role="robot"))
    for stack in robots.policies:
        for row, name in enumerate(stack.ids):
            yield robots.members[name], stack.spec, stack.row(row)


def _from_files(
    text: str, registry: Registry, may_match: bool
) -> Iterable[tuple[Member, Seat, Any]]:
    """Yield the robot of a file, or of each file that a glob names, s2 before s10."""
    globbed = may_match and glob.escape(text) != text and not Path(text).exists()
    files = glob.glob(_with_folders_as_spelled(text)) if globbed else [text]
    names = sorted(files, key=lambda name: (len(name), name))
    if not names:
        raise ValueError(f"policy {text!r} matches no file; list the folder with ls")
    for name in names:
        sha256 = _file_hash(name)  # first: a file that changes from then on is found out
        spec, params, metadata = read_policy_file(name)
        digest = row_sha256(flatten(params))
        robots = [entry for entry in registry.policies if entry.role == "robot"]
        same = [robot for robot in robots if robot.sha256 == digest]
        # A published robot's parameters are that robot, whatever else their file claims.
        member = _of_file(name, ((Path(name), sha256),), registry, {} if same else metadata)
        if same:
            member = dataclasses.replace(
                member,
                met=met_in_training(registry, same[0]),
                env_version=registry.env_version(same[0]),
            )
        yield member, spec, params


def _with_folders_as_spelled(pattern: str) -> str:
    """Escape the folders of a glob that are there: "run[1]/*" is about "run[1]", not "run1"."""
    slashes = (place for place, letter in enumerate(pattern) if letter == "/")
    there = [place for place in slashes if Path(pattern[: place + 1]).is_dir()]
    end = max(there, default=0)
    return glob.escape(pattern[:end]) + pattern[end:]


def _from_object(robot: Any, place: int, registry: Registry) -> tuple[Member, HostEgo]:
    """Take a robot of this process; no digest covers what it depends on."""
    kind = getattr(robot, "__qualname__", type(robot).__qualname__)
    name = f"object:{kind}-{place}"
    card = getattr(robot, "card", None)  # of a `Partner`
    met = met_in_training(registry, card) if isinstance(card, PolicyEntry) else NOT_KNOWN
    member = Member(name, identity_digest([name]), reusable=False, met=met)
    made_of = id(robot) if card is None else (robot.spec, card.sha256)
    return member, HostEgo(name, robot, made_of=made_of)


def _from_onnx(
    reference: PolicyReference, registry: Registry
) -> tuple[Member, Seat | HostEgo, Any]:
    """Return an ONNX file as the program that a service makes of it, with its parameters.

    A network that is larger, or of more operators, is played by onnxruntime. The digest of a
    program names that too: onnxruntime rounds differently.
    """
    path = Path(reference.source)
    try:
        data, files = read_model(path)
        claims = read_claims(data)
        member = _of_file(reference.text, files, registry, claims)
        spec, params = admission.read_program(data)
    except UntrustedModelError as error:
        if error.code not in admission.PLAYED_APART:
            raise EgoError(f"policy {reference.text!r}: {error}") from None
    except (ValueError, OSError) as error:
        raise EgoError(f"policy {reference.text!r}: {error}") from None
    except ImportError:  # the process says what to install
        _started(reference, onnx_ego.factory(path))
    else:
        digest = identity_digest([admission.PROGRAM, member.digest])
        return dataclasses.replace(member, digest=digest), spec, params
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / path.name
        whole.write_bytes(data)  # as it was read: in one piece, and not read again
        robot = _started(reference, onnx_ego.factory(whole))
    return member, HostEgo(member.id, robot, made_of=member.digest), None


def _from_code(reference: PolicyReference, registry: Registry, task: str) -> tuple[Member, HostEgo]:
    """Start the process of a robot from a Python module."""
    robot = _started(reference, (reference.source, reference.factory, reference.arguments))
    declared = robot.trained_with
    met = NOT_KNOWN if declared is None else declared_met(registry, task, declared)
    ego = HostEgo(reference.text, robot, robot.loaded, _made_of(reference, robot))
    return _python_member(reference, robot, met), ego


def _started(
    reference: PolicyReference, made_by: tuple[str, str, Mapping[str, str]]
) -> PolicyProcess:
    try:
        return PolicyProcess(*made_by)
    except (PolicyError, OSError) as error:
        raise EgoError(f"policy {reference.text!r}: {error}") from None


def _made_of(reference: PolicyReference, robot: PolicyProcess) -> Any:
    """Return the files, the factory and the arguments that make a robot of code."""
    contents = {str(path): sha256 for path, sha256 in robot.inputs}
    given = {name: contents.get(value, value) for name, value in reference.arguments.items()}
    hashes = (*robot.files.values(), *contents.values())
    return reference.factory, tuple(sorted(given.items())), tuple(sorted(hashes))


def _python_member(reference: PolicyReference, robot: PolicyProcess, met: Met) -> Member:
    """Describe a robot by all that its result is known to depend on.

    That is its code, the files that its arguments name, and those that its module declares, such as
    `DEPENDS = ["weights.pt"]`, relative to itself. Only with such a list, which may be empty, is
    the digest taken to cover everything.
    """
    files = (*robot.files.items(), *robot.inputs)
    hashes = [[path.name, sha256] for path, sha256 in files]
    return Member(
        reference.text,
        identity_digest([reference.text, hashes]),
        reusable=robot.declares,
        files=files,
        met=met,
    )


def _file_hash(path: str) -> str:
    """Return a file's sha256, empty if there is no file: its reader names the problem."""
    return file_sha256(Path(path)) if Path(path).is_file() else ""


def _of_file(text: str, files: Files, registry: Registry, claims: Mapping[str, Any]) -> Member:
    """Describe a file's robot by what the file claims: whom it met, and what it is told."""
    told: Any = claims.get("told")
    return Member(
        text,
        files[0][1] if len(files) == 1 else identity_digest([sha256 for _, sha256 in files]),
        files=files,
        met=claimed_met(registry, claims),
        env_version=claimed_version(claims),
        told="partner" if told == "partner" else told is True,
    )


def _span(partners: Sequence[str]) -> str:
    names = list(dict.fromkeys(partners))
    return names[0] if len(names) == 1 else f"{len(names)} partners from {names[0]} to {names[-1]}"
