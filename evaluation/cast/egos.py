"""Find the robots of a job: in the registry, in files, in Python code."""

import dataclasses
import glob
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from assistax_base.errors import ZooError
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
from population.networks.tensors import flatten, published_hashes
from population.views import View
from zoo.met.claims import claimed_met, claimed_version, declared_met
from zoo.met.published import NOT_KNOWN, Met, met_in_training
from zoo.parameters.storage import read_policy_file
from zoo.registry import Registry
from zoo.schema import PolicyEntry


class EgoError(ValueError):
    """A robot from outside failed; the message names the partner, the step and the fault."""


def read_egos(robots: Sequence[Any], registry: Registry, task: str) -> Roster:
    """Return the roster of references and Python objects; policies of one spec share a stack.

    Args:
        robots: Texts of the forms of `evaluation.cast.robot_names`, paths, globs of policy files,
            and objects of the forms of `evaluation.cast.robot_forms`.
        registry: The registry in which ids are looked up.
        task: The task of the robots that a glob matches.

    Raises:
        ValueError: A reference has an unknown form, or cannot play the robot.
        TypeError: An object has an unknown form.
        ZooError: An id or a file is missing, or its content is not as recorded.
        EgoError: A robot from a Python module cannot be made, or declares unknown partners.
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
    """Return a function (observations [N, O], step) -> actions [N, A] that checks the actions.

    The rows N are ordered partner by partner, with `episodes` rows for each of `partners`. The
    function raises an `EgoError` if the robot fails or an action is not finite.
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
        # A robot's code must not end a run.
        except (Exception, SystemExit, GeneratorExit) as error:
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
    """A robot from outside that also counts the numbers that the environment will clip.

    Args:
        act: A function of `call_ego`.
        length: Steps of an episode.
    """

    def __init__(self, act: Callable[[np.ndarray, int], np.ndarray], length: int) -> None:
        self._act, self._length = act, length
        # For each episode of a series, the sum over its steps of the clipped share [N].
        self._beyond: list[np.ndarray] = []

    def __call__(self, obs: Float[np.ndarray, "N O"], step: int) -> Float[np.ndarray, "N A"]:
        """Return the actions at a step of the series."""
        action = self._act(obs, step)
        if step % self._length == 0:
            self._beyond.append(np.zeros(len(obs)))
        self._beyond[-1] += (np.abs(action) > 1.0).mean(axis=1)
        return action

    def shares(self, shape: tuple[int, ...]) -> Float[np.ndarray, "E P K"]:
        """Return each episode's share of action numbers outside [-1, 1], in `shape` [E, P, K]."""
        return (np.stack(self._beyond, axis=-1) / self._length).reshape(shape)


def probe_egos(roster: Roster, task: str, observation_size: int, action_size: int) -> None:
    """Check every robot from outside with two rows of zeros, before programs are compiled for it.

    Raises:
        EgoError: A robot failed, or its actions have the wrong shape or type.
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
        # A robot's code must not end a run.
        except (Exception, SystemExit, GeneratorExit) as error:
            problem = f"failed: {error_text(error)}"
        if problem:
            raise EgoError(
                f"{ego.id} cannot play: given two rows of zeros it {problem}; the robot of task "
                f"{task} reads observations [N, {observation_size}] and gives actions "
                f"[N, {action_size}]"
            )


def _problem(answer: np.ndarray, shape: tuple[int, ...]) -> str:
    """Return the fault of a robot's answer as text; empty if its shape and type are right."""
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
    """Yield member, spec and parameters of each file that a path or glob names, s2 before s10."""
    globbed = may_match and glob.escape(text) != text and not Path(text).exists()
    files = glob.glob(_with_folders_as_spelled(text)) if globbed else [text]
    names = sorted(files, key=lambda name: (len(name), name))
    if not names:
        raise ValueError(f"policy {text!r} matches no file; list the folder with ls")
    for name in names:
        # Hashed before it is read, so that a later change of the file is detected.
        sha256 = _file_hash(name)
        spec, params, metadata = read_policy_file(name)
        digests = published_hashes(flatten(params))
        robots = [entry for entry in registry.policies if entry.role == "robot"]
        same = [robot for robot in robots if robot.sha256 in digests]
        # Parameters equal to a published robot's are that robot; their file's claims are ignored.
        member = _of_file(name, ((Path(name), sha256),), registry, {} if same else metadata)
        if same:
            member = dataclasses.replace(
                member,
                met=met_in_training(registry, same[0]),
                env_version=registry.env_version(same[0]),
            )
        yield member, spec, params


def _with_folders_as_spelled(pattern: str) -> str:
    """Return a glob with its existing folders escaped: "run[1]/*" means "run[1]", not "run1"."""
    slashes = (place for place, letter in enumerate(pattern) if letter == "/")
    existing = [place for place in slashes if Path(pattern[: place + 1]).is_dir()]
    end = max(existing, default=0)
    return glob.escape(pattern[:end]) + pattern[end:]


def _from_object(robot: Any, place: int, registry: Registry) -> tuple[Member, HostEgo]:
    """Return member and ego of a Python object, whose results no digest covers."""
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
    """Return member, spec and parameters of an ONNX file that is played as a JAX program.

    A network that is too large for a program, or has other operators, is played by onnxruntime: its
    spec is a `HostEgo` and its parameters are None. The digest says which of the two plays, because
    onnxruntime rounds differently.
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
    except ImportError:
        # Raises an error that says which package to install.
        _started(reference, onnx_ego.factory(path))
    else:
        digest = identity_digest([admission.PROGRAM, member.digest])
        return dataclasses.replace(member, digest=digest), spec, params
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / path.name
        # The bytes as they were checked, so that the process does not read the original again.
        whole.write_bytes(data)
        robot = _started(reference, onnx_ego.factory(whole))
    return member, HostEgo(member.id, robot, made_of=member.digest), None


def _from_code(reference: PolicyReference, registry: Registry, task: str) -> tuple[Member, HostEgo]:
    """Start a robot of a Python module in its own process; return its member and ego."""
    robot = _started(reference, (reference.source, reference.factory, reference.arguments))
    met = NOT_KNOWN
    if (declared := robot.trained_with) is not None:
        try:
            met = declared_met(registry, task, declared)
        except (ValueError, ZooError) as error:
            place = f"policy {reference.text!r}: TRAINED_WITH of {reference.source}"
            raise EgoError(f"{place}: {error}") from error
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
    """Return a key that is equal for equal robots: factory, arguments and hashes of the files."""
    contents = {str(path): sha256 for path, sha256 in robot.inputs}
    given = {name: contents.get(value, value) for name, value in reference.arguments.items()}
    hashes = (*robot.files.values(), *contents.values())
    return reference.factory, tuple(sorted(given.items())), tuple(sorted(hashes))


def _python_member(reference: PolicyReference, robot: PolicyProcess, met: Met) -> Member:
    """Return the member of a robot of code, with a digest of everything that it depends on.

    The digest covers its code, the files that its arguments name, and the files that its module
    declares, such as `DEPENDS = ["weights.pt"]`, relative to the module. Results are reusable only
    if the module has such a list, which may be empty.
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
    """Return the member of a robot's file, with its claimed partners, version and observations."""
    return Member(
        text,
        files[0][1] if len(files) == 1 else identity_digest([sha256 for _, sha256 in files]),
        files=files,
        met=claimed_met(registry, claims),
        env_version=claimed_version(claims),
        view=View.claimed(claims),
    )


def _span(partners: Sequence[str]) -> str:
    names = list(dict.fromkeys(partners))
    return names[0] if len(names) == 1 else f"{len(names)} partners from {names[0]} to {names[-1]}"
