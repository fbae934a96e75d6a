"""One frozen policy in one seat of one simulation: NumPy observations in, NumPy actions out."""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Float32, Shaped

from assistax_base.errors import UnknownIdError
from assistax_envs.disability import DISABILITY_SETTINGS, Disability
from evaluation.cast.egos import call_ego, read_egos
from evaluation.cast.robot_names import parse_reference
from evaluation.cast.roster import check_seat
from population.networks.seat import Seat
from population.trainers.environment import Environment
from zoo.parameters.storage import load_stacks, read_policy_file
from zoo.registry import Registry
from zoo.schema import PolicyEntry


@dataclasses.dataclass(frozen=True)
class Seated:
    """Who plays a role in one simulation: from an observation [O] to an action [A]."""

    act: Callable[[np.ndarray], np.ndarray]
    setting: Disability | None = None  # a human's, where its zoo or its file says it
    card: PolicyEntry | None = None  # of a policy of the zoo

    def __call__(self, obs: Float[np.ndarray, " O"]) -> Float[np.ndarray, " A"]:
        """Act once."""
        return self.act(obs)


class Partner:
    """A frozen policy in its seat: NumPy observations in, its most likely actions out.

    Fits the human's seat of the Gymnasium adapter, which resets it and takes its setting from here.

    Attributes:
        id: Such as "scratch/ippo-d1-s0-v1/human", or the path of its file.
        spec: Its network: role, sizes, layers.
        setting: A human's disability setting, as values; None where its file names none.
        card: What the registry says of it: training, self-play, hash; None of a file.

    Examples:
        >>> from assistax_zoo import open_zoo
        >>> partner = open_zoo().partner("scratch/ippo-d1-s0-v1")
        >>> partner.act(np.zeros((2, partner.spec.observation_size), np.float32)).shape
        (2, 3)
    """

    def __init__(
        self,
        id: str,
        spec: Seat,
        params: dict[str, Any],
        setting: Disability | None = None,
        card: PolicyEntry | None = None,
    ) -> None:
        self.id, self.spec, self.setting, self.card = id, spec, setting, card
        self._params = jax.device_put(params)
        self._carry: Any = None

    def reset(self, rows: int | None = None) -> None:
        """Forget the episode; `rows`, how many begin, is what evaluators say, and is not needed."""
        del rows
        self._carry = None

    def act(self, obs: Shaped[np.ndarray, "*batch O"]) -> Float32[np.ndarray, "*batch A"]:
        """Return actions.

        Args:
            obs: Observations [..., O]; the leading axes stay the same within an episode.

        Returns:
            Actions [..., A] in [-1, 1], float32.

        Raises:
            ValueError: O is not `spec.observation_size`.
        """
        obs = np.asarray(obs, np.float32)
        if obs.shape[-1:] != (self.spec.observation_size,):
            raise ValueError(
                f"{self.id} got observations {obs.shape}; expected [..., "
                f"{self.spec.observation_size}]"
            )
        # Two rows at least, as in the evaluator: a product with one row is rounded differently on
        # the CPU.
        batch = np.broadcast_to(obs, (2, *obs.shape)) if obs.ndim == 1 else obs
        first = np.full(batch.shape[:-1], self._carry is None)
        if self._carry is None:
            self._carry = self.spec.player().initial_carry(first.shape)
        self._carry, action = _acting(self.spec)(self._params, self._carry, batch, first)
        return np.array(action[0] if obs.ndim == 1 else action)

    __call__ = act

    def __repr__(self) -> str:
        return f"Partner({self.id!r}, {self.spec.observation_size} -> {self.spec.action_size})"


def zoo_partner(registry: Registry, policy: str, role: str = "human") -> Partner:
    """Return one policy of the registry by its id or its team's, hashes checked.

    Raises:
        ZooError: no policy of that role has the id, or its bytes are not those of the registry.
    """
    entries = registry.select(policy, role=role)
    if len(entries) != 1:
        raise UnknownIdError(
            f"{policy!r} is not one policy",
            expected="the id of one policy",
            found=f"{len(entries)} that match, such as {entries[0].id}",
            done="nothing was loaded",
            next_step="name one; `assistax-zoo list` prints every id",
        )
    [group], [entry] = load_stacks(registry, entries), entries
    return Partner(entry.id, group.spec, group.row(0), entry.setting, entry)


def seat_policy(
    reference: str,
    role: str,
    env: Environment,
    registry: Callable[[], Registry],
    task: str,
    seed: int = 0,
) -> Seated:
    """Return who plays `role`, checked to fit.

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


def _seated(policy: Partner, role: str, env: Environment, task: str) -> Seated:
    """Return a policy in its seat, which must be the role's."""
    check_seat(policy.id, policy.spec, role, env, task)
    return Seated(policy.act, policy.setting, policy.card)


def _outside(reference: str, role: str, env: Environment, registry: Registry, task: str) -> Seated:
    """Return a robot from outside, which takes batches, for one observation at a time."""
    if role != "robot":
        raise ValueError(
            f"policy {reference!r} cannot play the {role}; code and ONNX files play the robot"
        )
    egos = read_egos([reference], registry, task)
    if egos.policies:  # an ONNX file that is played as a program
        [stack] = egos.policies
        return _seated(Partner(reference, stack.spec, stack.row(0)), role, env, task)
    [ego] = egos.hosts
    act, steps = call_ego(ego, ["its partner"], 1, env.action_size[role]), itertools.count()
    return Seated(lambda obs: act(obs[None], next(steps))[0])


@functools.cache
def _acting(spec: Seat) -> Callable[..., tuple[Any, jax.Array]]:
    policy = spec.player()
    return jax.jit(
        lambda params, carry, obs, first: policy.act(params, carry, jnp.asarray(obs), first)
    )
