"""Blocks of work on a Ray cluster.

Tasks that leave their results as files in a folder that all machines share.

Ray itself is imported on use only.
"""

import dataclasses
import os
import socket
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from assistax_base.extras import optional

# Of missing results.
NOT_SHARED = "write to a folder that all machines of the cluster share under the same path"
_INHERITED = ("JAX_PLATFORMS", "XLA_FLAGS")  # what a worker elsewhere must know of the caller's JAX


@dataclasses.dataclass(frozen=True)
class RayCluster:
    """Ray cluster that runs blocks, and the resources of a block."""

    address: str | None = (
        None  # of a running cluster, such as "auto" or "ray://head:10001"; None starts one here
    )
    cpus: float | None = (
        # Of each block; None is 1 beside a GPU, else a whole machine: `native` uses all its cores.
        None
    )
    gpus: float = 0.0  # of each block; 0.5 puts two on one GPU

    def __post_init__(self) -> None:
        if not (
            self.gpus >= 0 and (self.cpus is None or (self.cpus >= 0 and self.cpus + self.gpus > 0))
        ):
            raise ValueError(
                f"a block takes {self.cpus} CPUs and {self.gpus} GPUs; give 0 or more, and not 0 "
                "of both"
            )
        if self.gpus > 1 and self.gpus != int(self.gpus):
            raise ValueError(f"a block takes {self.gpus:g} GPUs; above 1, Ray gives whole ones")


class BlocksFailedError(ValueError):
    """Blocks ended with an error. The results of the others are kept."""


def run_blocks(
    cluster: RayCluster,
    blocks: Callable[[int], Sequence[str]],
    work: Callable[..., Any],
    shared: Sequence[Any],
    on_done: Callable[[int], None] | None = None,
) -> None:
    """Call `work(number, count, *shared)` on the cluster for each block, and wait for all of them.

    A worker imports `work` by its name, so its machine needs this code; it writes to the same
    folders as the caller.

    Args:
        cluster: Where.
        blocks: Says, given how many run at once, what to call each of them in messages.
        work: A function of a module.
        shared: Arguments of all blocks, sent to each machine once.
        on_done: Called with the number of each block that is done.

    Raises:
        ValueError: Ray is not installed, the cluster is not there, or it can never give what a
            block takes.
        BlocksFailedError: Blocks failed, each with its reason, after all others are done.
    """
    ray = optional("ray", "the engine ray", "ray")
    began = not ray.is_initialized()
    try:
        if began:
            _connect(ray, cluster.address)
        cluster = _resolved(ray, cluster)
        names = blocks(_slots(ray, cluster))
        failures = _run(ray, cluster, names, work, shared, on_done)
    finally:
        if began:
            ray.shutdown()
    if failures:
        raise BlocksFailedError(
            f"{len(failures)} of {len(names)} blocks failed: "
            + "; ".join(f"{names[number]}: {reason}" for number, reason in sorted(failures.items()))
            + "; finished blocks are kept; the same command continues with the others"
        )


def _run(
    ray: Any,
    cluster: RayCluster,
    names: Sequence[str],
    work: Callable[..., Any],
    shared: Sequence[Any],
    on_done: Callable[[int], None] | None,
) -> dict[int, str]:
    """Return the reasons of failed blocks, by the number of the block."""
    # A task is tried again where its machine was lost, not where it raised: blocks go on from what
    # they wrote.
    task = ray.remote(
        num_cpus=cluster.cpus,
        num_gpus=cluster.gpus,
        max_retries=1,
        runtime_env={"env_vars": _variables(cluster)},
    )(work)
    references = [ray.put(value) for value in shared]
    waiting = {task.remote(number, len(names), *references): number for number in range(len(names))}
    failures = {}
    while waiting:
        (done, *_), _ = ray.wait(list(waiting), num_returns=1)
        number = waiting.pop(done)
        try:
            ray.get(done)
        except ray.exceptions.RayError as error:
            failures[number] = _reason(error)
            continue
        if on_done is not None:
            on_done(number)
    return failures


def _connect(ray: Any, address: str | None, **options: Any) -> None:
    """Join a cluster, or start one on this machine that only it can reach."""
    if address is None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options |= {"address": "local", "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
    else:
        options["address"] = address
    try:
        if address is not None:
            _knock(address)
        with warnings.catch_warnings():
            # JAX warns of any fork; what Ray forks here becomes another program at once.
            warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
            ray.init(log_to_driver=False, logging_level="ERROR", **options)
    except OSError as error:
        raise ValueError(
            f"no Ray cluster answers at {address!r} ({_first_line(error)}); start one with `ray "
            "start`, or give no address to use this machine alone"
        ) from None


def _knock(address: str) -> None:
    """Refuse a dead address within seconds. Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():
        with socket.create_connection((host, int(port)), timeout=10.0):
            pass


def _resolved(ray: Any, cluster: RayCluster) -> RayCluster:
    """Return the cluster settings with the CPUs of a block: a whole machine's if not given."""
    if cluster.cpus is not None:
        return cluster
    machines = [node["Resources"].get("CPU", 0.0) for node in ray.nodes() if node["Alive"]]
    whole = min((cpus for cpus in machines if cpus > 0), default=1.0)
    return dataclasses.replace(cluster, cpus=1.0 if cluster.gpus else whole)


def _slots(ray: Any, cluster: RayCluster) -> int:
    """Return the number of blocks that the cluster runs at once."""
    has = ray.cluster_resources()
    block = {"CPU": cluster.cpus or 0.0, "GPU": cluster.gpus}
    slots = min(int(has.get(name, 0) / amount) for name, amount in block.items() if amount > 0)
    if slots < 1:
        raise ValueError(
            f"the Ray cluster has {has.get('CPU', 0):g} CPUs and {has.get('GPU', 0):g} GPUs, and a "
            f"block takes {block['CPU']:g} and {block['GPU']:g}; give a block fewer CPUs or "
            "GPUs"
        )
    return slots


def _variables(cluster: RayCluster) -> dict[str, str]:
    """Return the environment variables of a worker.

    Where blocks share a GPU, each gets its part of the memory.
    """
    variables = {name: os.environ[name] for name in _INHERITED if name in os.environ}
    if 0 < cluster.gpus < 1:
        variables["XLA_PYTHON_CLIENT_MEM_FRACTION"] = f"{0.9 * cluster.gpus:.3f}"
    return variables


def _reason(error: Exception) -> str:
    """Return the reason of a failed block: its error, or the fate of its worker."""
    cause = getattr(error, "cause", None) or error
    return f"{type(cause).__name__}: {_first_line(cause)}"


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0]
