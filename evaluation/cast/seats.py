"""Policies for one role of one simulation, by reference, for films and recorded episodes."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from assistax_envs.disability import DISABILITY_SETTINGS, Disability
from evaluation.cast.cast import version_of_all
from evaluation.cast.egos import call_ego, read_egos
from evaluation.cast.partners import Partner, zoo_partner
from evaluation.cast.robot_names import parse_reference
from evaluation.cast.roster import check_seat
from population.environment import Environment
from zoo.met.claims import claimed_version
from zoo.parameters.storage import read_policy_file
from zoo.registry import Registry
from zoo.schema import PolicyEntry


@dataclasses.dataclass(frozen=True)
class Seated:
    """A policy in one role of one simulation: from an observation [O] to an action [A]."""

    act: Callable[[np.ndarray], np.ndarray]
    setting: Disability | None = None  # a human's setting, if its zoo or its file has one
    card: PolicyEntry | None = None  # the registry's entry, if it is a policy of the zoo
    humans: Any = None  # a person's own `EnvParams` [1]
    # The word said with the last action, a code of `preferences.WORDS`; None if it never speaks.
    word: Callable[[], Any] | None = None

    def __call__(self, obs: Float[np.ndarray, " O"]) -> Float[np.ndarray, " A"]:
        """Return the action [A] for one observation [O]."""
        return self.act(obs)


def seat_policy(
    reference: str,
    role: str,
    env: Environment,
    registry: Callable[[], Registry],
    task: str,
    seed: int = 0,
) -> Seated:
    """Return the policy that a reference names for `role`, checked to fit.

    Args:
        reference: zoo:ID, a path to a .safetensors file, "zero", or "random"; for the robot also
            python: and onnx:.
        role: "robot" or "human".
        env: The environment.
        registry: Returns the registry; called only if it is needed.
        task: The environment's task.
        seed: The seed of random actions.

    Raises:
        ValueError: The reference has an unknown form, or the policy does not fit.
        ZooError: An id or a file is missing, or its content is not as recorded.
    """
    size, named = env.action_size[role], parse_reference(reference)
    named.check(task, role)
    if named.kind == "zero":
        return Seated(lambda obs: np.zeros(size, np.float32))
    if named.kind == "random":
        rng = np.random.default_rng([seed, list(env.action_size).index(role)])
        return Seated(lambda obs: rng.uniform(-1.0, 1.0, size).astype(np.float32))
    if named.kind in ("python", "onnx"):
        return _outside(reference, role, env, registry(), task)
    if named.kind == "zoo":
        policy = zoo_partner(registry(), named.source, role)
    else:
        spec, params, metadata = read_policy_file(Path(named.source))
        setting = DISABILITY_SETTINGS.get(str(metadata.get("disability")))
        policy = Partner(reference, spec, params, setting)
    return _seated(policy, role, env, task)


def version_of(
    references: Mapping[str, str], task: str, registry: Callable[[], Registry]
) -> int | None:
    """Return the environment version that policies share; None if no zoo or file names one.

    Args:
        references: References by role, as in `seat_policy`.
        task: The environment's task.
        registry: Returns the registry; called only if it is needed.

    Raises:
        ZooError: A policy is missing, or the policies share no version.
    """
    named = {role: parse_reference(reference) for role, reference in references.items()}
    sources = [(role, name.source) for role, name in named.items() if name.kind == "zoo"]
    entries = [entry for role, source in sources for entry in registry().select(source, role=role)]
    files = {name.source for name in named.values() if name.kind == "file"}
    claims = {name: claimed_version(read_policy_file(Path(name)).metadata) for name in files}
    claimed = {name: version for name, version in claims.items() if version is not None}
    if not entries and not claimed:
        return None
    return version_of_all(registry(), task, entries, claimed)


def _seated(policy: Partner, role: str, env: Environment, task: str) -> Seated:
    """Return a policy in its seat, checked to fit the role."""
    check_seat(policy.id, policy.spec, role, env, task)
    word = policy.word if role == "human" else None
    return Seated(policy.act, policy.setting, policy.card, policy.humans, word)


def _outside(reference: str, role: str, env: Environment, registry: Registry, task: str) -> Seated:
    """Return a robot of code or of an ONNX file, called with one observation at a time."""
    if role != "robot":
        raise ValueError(
            f"policy {reference!r} cannot play the {role}; code and ONNX files play the robot"
        )
    egos = read_egos([reference], registry, task)
    # An ONNX file that is played as a program is a policy stack.
    if egos.policies:
        [stack] = egos.policies
        return _seated(Partner(reference, stack.spec, stack.row(0)), role, env, task)
    [ego] = egos.hosts
    act, steps = call_ego(ego, ["its partner"], 1, env.action_size[role]), itertools.count()
    return Seated(lambda obs: act(obs[None], next(steps))[0])
