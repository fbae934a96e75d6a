"""Admission of robots' files. The server and `submit --check` at home run this very code."""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from assistax_board.problems import Problem, Refusal
from assistax_board.robots.limited import BusyError, DiedError, OverBudgetError, run_limited
from assistax_board.robots.robot_cost import MOST, nanoseconds
from assistax_board.rules.submissions import MAX_BYTES, Admitted
from population.networks.seat import Seat

SAFETENSORS, ONNX = "safetensors", "onnx"
# Version, producer, its version, graph and operator sets of a model, in any order.
_FIRST_FIELDS = (b"\x08", b"\x12", b"\x1a", b"\x3a", b"\x42")
_PROBES = (0.0, 1.0, -1.0, 10.0, -10.0)  # observations that a robot must survive
_FAST: dict[str, str | bool] = {
    "xla_backend_optimization_level": "0",
    "xla_llvm_disable_expensive_passes": True,
}
SECONDS = 30  # of processors for a file's admission; a large network takes two
BYTES = 1536 * 1024 * 1024  # of memory, of which JAX and its programs are a sixth


@dataclasses.dataclass(frozen=True)
class Robot:
    """Spec and parameters of an admitted robot."""

    format: str
    spec: Seat  # of a network of ours, or of an ONNX graph
    params: dict[str, Any]  # without a stacked axis
    env_version: int | None = None  # in which it was trained, as its file says


class Admission:
    """Admits robots of the tasks of a registry."""

    def __init__(self, sizes: dict[str, tuple[int, int]]) -> None:
        """Prepare to admit; `sizes` are a robot's observations and actions by task."""
        self._sizes = sizes

    def __call__(self, data: bytes, task: str) -> Admitted:
        """Return the format and version of a robot's file, read in a process of its own.

        Raises:
            Refusal: It cannot be scored, and why.
            Problem: The machine is too busy to say.
        """
        if len(data) > MAX_BYTES:
            raise Refusal("too_large", f"{len(data)} bytes")
        limits = {"seconds": SECONDS, "most_bytes": BYTES}
        try:
            answer = run_limited(_admit, self._sizes, data, task, **limits)
        except OverBudgetError as error:
            code = "too_slow" if error.what == "seconds" else "graph_too_large"
            raise Refusal(code, f"to be looked at {error}") from None
        except DiedError:
            raise Refusal("malformed", "its reader died of it") from None
        except BusyError:
            raise Problem("unavailable", "the server is busy; try again soon") from None
        if refusal := answer.get("refusal"):
            raise Refusal(*refusal)
        return Admitted(**answer)

    def read(self, data: bytes, task: str) -> Robot:
        """Return the robot in a file.

        Raises:
            Refusal: It cannot be scored, and why.
        """
        if len(data) > MAX_BYTES:
            raise Refusal("too_large", f"{len(data)} bytes")
        observation_size, action_size = self._sizes[task]
        if is_safetensors(data):
            robot = _read_safetensors(data, observation_size, action_size)
        elif is_onnx(data):
            robot = _read_onnx(data, observation_size, action_size)
        else:
            raise Refusal("unknown_format")
        _check_cost(robot)
        _check_finite(robot)
        return robot


def _admit(sizes: dict[str, tuple[int, int]], data: bytes, task: str) -> dict[str, Any]:
    """Return the admission of a file as JSON; run in a process of its own."""
    import jax

    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_compilation_cache_dir", None)  # strangers' programs are not kept
    try:
        robot = Admission(sizes).read(data, task)
        return {"format": robot.format, "env_version": robot.env_version}
    except Refusal as refusal:
        return {"refusal": (refusal.code, refusal.detail[:300])}
    except MemoryError:
        return {"refusal": ("graph_too_large", "memory")}
    except Exception as error:  # whatever a damaged file makes of its reader
        return {"refusal": ("malformed", type(error).__name__)}


def robot_sizes(registry: Any) -> dict[str, tuple[int, int]]:
    """Return the widths of a robot's observations and actions by task."""
    robots = registry.select(role="robot")
    return {
        robot.task: (robot.spec.observation_size, robot.spec.action_size)
        for robot in robots
        if robot.release == registry.release_of(robot.task)
    }


def is_safetensors(data: bytes) -> bool:
    """Return whether bytes begin as a safetensors file: a length, then JSON."""
    return len(data) > 9 and data[8:9] == b"{" and int.from_bytes(data[:8], "little") < len(data)


def is_onnx(data: bytes) -> bool:
    """Return whether bytes begin as an ONNX model: a field that protobuf may write first."""
    return data[:1] in _FIRST_FIELDS and len(data) > 1


def _read_safetensors(data: bytes, observation_size: int, action_size: int) -> Robot:
    from assistax_base.errors import ZooError
    from population.networks.tensors import flatten
    from zoo.met.claims import claimed_version
    from zoo.parameters.encoding import check_params
    from zoo.parameters.storage import read_policy_file

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.safetensors"
        path.write_bytes(data)
        try:
            spec, params, metadata = read_policy_file(path)
        except (ZooError, ValueError, TypeError) as error:
            raise Refusal("malformed", str(error)[:300]) from None
    if spec.role != "robot":
        raise Refusal("wrong_role", spec.role)
    if (spec.observation_size, spec.action_size) != (observation_size, action_size):
        raise Refusal("wrong_sizes", f"{spec.observation_size} and {spec.action_size}")
    if len(spec.hidden) > 32 or max(spec.hidden) > 65_536:
        raise Refusal("graph_too_large", f"layers {spec.hidden[:8]}")
    try:
        check_params(spec, flatten(params), "this file")
    except (ZooError, ValueError, TypeError) as error:
        raise Refusal("wrong_parameters", str(error)[:300]) from None
    return Robot(SAFETENSORS, spec, params, claimed_version(metadata))


def _read_onnx(data: bytes, observation_size: int, action_size: int) -> Robot:
    from evaluation.cast.onnx_robots.admission import admit_onnx
    from evaluation.cast.onnx_robots.ego import UntrustedModelError
    from evaluation.cast.onnx_robots.files import read_claims
    from zoo.met.claims import claimed_version

    try:
        spec, params = admit_onnx(data, observation_size, action_size)
    except UntrustedModelError as error:
        raise Refusal(error.code, str(error)) from None
    return Robot(ONNX, spec, params, claimed_version(read_claims(data)))


def _check_cost(robot: Robot) -> None:
    """Refuse a robot that would take a worker hours or gigabytes."""
    cost = nanoseconds(robot.spec.player(), robot.params, robot.spec.observation_size)
    if cost > MOST:
        raise Refusal("too_slow", f"{cost:.3g} of {MOST:.3g} nanoseconds for an observation")


def _check_finite(robot: Robot) -> None:
    """Play a few steps of made-up observations; numbers that are not finite are refused now."""
    import jax
    import jax.numpy as jnp

    policy = robot.spec.player()
    obs = jnp.asarray(
        [np.full(robot.spec.observation_size, value, np.float32) for value in _PROBES]
    )
    carry, first = policy.initial_carry((len(_PROBES),)), jnp.ones(len(_PROBES), bool)
    # Compiled whole, else each operator is by itself: minutes for a thousand. And fast, not well:
    # a chain of two thousand operators takes a compiler that does its best nine seconds, this one.
    traced = jax.jit(policy.act).lower(robot.params, carry, obs, first)
    act = traced.compile(compiler_options=_FAST)
    for _ in range(2):
        carry, action = act(robot.params, carry, obs, first)
        if not bool(jnp.isfinite(action).all()):
            raise Refusal("not_finite", "its actions")
        first = jnp.zeros(len(_PROBES), bool)
