"""Who plays a seat of one simulation, by its reference: from an observation to an action."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.cast.egos import call_ego, read_egos
from evaluation.cast.partners import Partner, zoo_partner
from evaluation.cast.robot_names import parse_reference
from evaluation.cast.roster import HostEgo
from zoo.parameters.storage import read_policy_file
from zoo.registry import Registry


class Seats(Protocol):
    """What is asked of an environment to put a policy into it."""

    @property
    def observation_size(self) -> dict[str, int]: ...
    @property
    def action_size(self) -> dict[str, int]: ...


def seat_policy(
    reference: str,
    role: str,
    env: Seats,
    registry: Callable[[], Registry],
    task: str,
    seed: int = 0,
) -> Callable[[np.ndarray], np.ndarray]:
    """Return who plays `role`, checked to fit: from an observation [O] to an action [A].

    Args:
        reference: zoo:ID, a path to a .safetensors file, "zero", or "random"; for the robot also
            python: and onnx:.
        role: "robot" or "human".
        env: the environment.
        registry: read when it is needed.
        task: the environment's.
        seed: of random actions.

    Raises:
        ValueError: the reference has none of the known forms, or does not fit.
        ZooError: an id or a file that is not there or not what it says.
    """
    size, named = env.action_size[role], parse_reference(reference)
    named.check(task, role)
    if named.kind == "zero":
        return lambda obs: np.zeros(size, np.float32)
    if named.kind == "random":
        rng = np.random.default_rng([seed, list(env.action_size).index(role)])
        return lambda obs: rng.uniform(-1.0, 1.0, size).astype(np.float32)
    if named.kind in ("python", "onnx"):
        return _outside(reference, role, env, registry(), task)
    if named.kind == "zoo":
        policy = zoo_partner(registry(), named.source, role)
    else:
        spec, params, metadata = read_policy_file(Path(named.source))
        setting = DISABILITY_SETTINGS.get(str(metadata.get("disability")))
        policy = Partner(reference, spec, params, setting)
    _check_seat(policy, role, env)
    return policy


def _check_seat(policy: Partner, role: str, env: Seats) -> None:
    spec = policy.spec
    if spec.role != role:
        raise ValueError(
            f"{policy.id} plays the {spec.role}, not the {role}; give it with --{spec.role}"
        )
    expected, found = (
        (env.observation_size[role], env.action_size[role]),
        (spec.observation_size, spec.action_size),
    )
    if found != expected:
        raise ValueError(
            f"{policy.id} takes {found[0]} observations to {found[1]} actions; the {role} of "
            f"this task has {expected[0]} and {expected[1]}: give a policy that was trained on "
            "this task"
        )


def _outside(
    reference: str, role: str, env: Seats, registry: Registry, task: str
) -> Callable[[np.ndarray], np.ndarray]:
    """Return a robot from outside, which takes batches, as a callable on one observation."""
    if role != "robot":
        raise ValueError(
            f"policy {reference!r} cannot play the {role}; code and ONNX files play the robot"
        )
    [ego] = read_egos([reference], registry, task).stacks
    if not isinstance(ego, HostEgo):  # an ONNX file that is played as a program
        policy = Partner(reference, ego.spec, ego.row(0))
        _check_seat(policy, role, env)
        return policy
    act, steps = call_ego(ego, ["its partner"], 1, env.action_size[role]), itertools.count()
    return lambda obs: act(obs[None], next(steps))[0]
