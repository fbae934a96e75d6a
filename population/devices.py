"""Members spread over the devices of a host.

Each device runs the ordinary program on its share of them.

Members never read one another, so no device waits for another: each is given its own program by its
own thread. One program over all devices would do on a CPU, but XLA's compiler crashes on one that
calls Warp (JAX 0.11.2, Warp 1.18).
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, SingleDeviceSharding
from jax.sharding import PartitionSpec as P

from assistax_envs.own_settings import own_settings

AXIS = "members"
FIRST_AXIS = P(AXIS)  # of length M, or N member by member, is split
SECOND_AXIS = P(None, AXIS)
WHOLE = P()  # every device holds all of it


def own_devices(cores: int = 1) -> tuple[jax.Device, ...]:
    """Return all GPUs of this process; without GPUs, the first `cores` CPU devices."""
    devices = tuple(jax.local_devices())
    return devices if jax.default_backend() != "cpu" else devices[: max(1, cores)]


class DeviceShares:
    """Equal shares of M members, one for each device in use, in the order of the devices.

    With one device nothing is split: programs are those that stand outside.

    Args:
        members: M.
        devices: Those that may be used; if not given `own_devices`, of CPUs one, since programs for
            shares of another size may round differently. In use are as many as divide M.
    """

    def __init__(self, members: int, devices: Sequence[jax.Device] | None = None) -> None:
        allowed = tuple(own_devices() if devices is None else devices)
        if not allowed or len(set(allowed)) < len(allowed):
            raise ValueError(f"devices are {list(allowed)}; give at least one, and each once")
        count = max(d for d in range(1, len(allowed) + 1) if members % d == 0)
        self.devices = allowed[:count]
        self._mesh = Mesh(np.array(self.devices), (AXIS,)) if count > 1 else None
        self._threads = ThreadPoolExecutor(count, "device")

    def __len__(self) -> int:
        return len(self.devices)

    def __enter__(self) -> "DeviceShares":
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for the threads to end, so that no device is held when the interpreter stops."""
        self._threads.shutdown()

    def jit(
        self, function: Callable[..., Any], out_specs: Any = FIRST_AXIS, **options: Any
    ) -> Callable[..., Any]:
        """Return a jitted function of all members, made of one that accepts any number of members.

        Positional arguments are as `put` returns them, keywords are static; `out_specs` say how
        results are put together, one for all leaves or a tree like the result's.
        """
        jitted, mesh = jax.jit(function, **options), self._mesh
        if mesh is None:
            return jitted

        def call(*args: Any, **static: Any) -> Any:
            # Donating a part deletes the whole array, so all parts are taken first.
            arguments = [jax.tree.map(partial(_part, device), args) for device in self.devices]
            # Settings of JAX hold for one thread, and each share runs in its own.
            share = own_settings()(lambda args: jitted(*args, **static))
            parts = list(self._threads.map(share, arguments))
            return jax.tree.map(
                lambda spec, *part: jax.tree.map(
                    lambda *leaves: _join(NamedSharding(mesh, spec), leaves), *part
                ),
                out_specs,
                *parts,
            )

        return call

    def put(self, tree: Any, spec: Any = FIRST_AXIS) -> Any:
        """Return a pytree on the devices, each of its leaves split in the same way."""
        if self._mesh is None:
            return self.gather(tree)
        return jax.device_put(tree, NamedSharding(self._mesh, spec))

    def gather(self, tree: Any) -> Any:
        """Return a pytree on the first device."""
        return jax.device_put(tree, SingleDeviceSharding(self.devices[0]))


def _part(device: jax.Device, leaf: jax.Array) -> jax.Array:
    """Return the part of an array that a device holds."""
    return next(shard.data for shard in leaf.addressable_shards if shard.device == device)


def _join(sharding: NamedSharding, parts: Sequence[jax.Array]) -> jax.Array:
    """Return the array of parts that lie on the devices already; nothing is copied."""
    shape = list(parts[0].shape)
    for axis, name in enumerate(sharding.spec):
        shape[axis] *= len(parts) if name == AXIS else 1
    return jax.make_array_from_single_device_arrays(tuple(shape), sharding, list(parts))


def state_specs(state: Any, partners: Any) -> Any:
    """Return the partition of a training state over devices, as a tree of its structure.

    Counters are whole on each device; other leaves are laid out member by member.

    Args:
        state: A training state, or its shapes.
        partners: Frozen partners, whose carries may be [partner, member x simulation] instead; see
            their `member_axes`.
    """
    specs = jax.tree.map(lambda leaf: FIRST_AXIS if leaf.ndim else WHOLE, state)
    if not partners:
        return specs
    axes = partners.member_axes(state.simulations.partners)
    carries = jax.tree.map(lambda axis: SECOND_AXIS if axis else FIRST_AXIS, axes)
    return dataclasses.replace(
        specs, simulations=dataclasses.replace(specs.simulations, partners=carries)
    )
