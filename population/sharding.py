"""Members spread over the devices of a host: each device runs the ordinary program on its share of them.

Members never read one another, so no device waits for another. The program is split by `jax.shard_map` and not by the
compiler, which cannot look into the calls that step the physics and would copy all simulations to every device.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, SingleDeviceSharding
from jax.sharding import PartitionSpec as P

AXIS = "members"
FIRST_AXIS = P(AXIS)  # of length M, or N member by member, is split
SECOND_AXIS = P(None, AXIS)
WHOLE = P()  # every device holds all of it


class Shares:
    """Equal shares of M members, one for each device in use, in the order of the devices.

    With one device nothing is split: programs are those that stand outside.

    Args:
        members: M.
        devices: Those that may be used; all of this process if not given. In use are as many as divide M.
    """

    def __init__(self, members: int, devices: Sequence[jax.Device] | None = None) -> None:
        allowed = tuple(jax.local_devices() if devices is None else devices)
        if not allowed or len(set(allowed)) < len(allowed):
            raise ValueError(f"devices are {list(allowed)}; give at least one, and each once")
        count = max(d for d in range(1, len(allowed) + 1) if members % d == 0)
        self.devices = allowed[:count]
        self._mesh = Mesh(np.array(self.devices), (AXIS,)) if count > 1 else None

    def __len__(self) -> int:
        return len(self.devices)

    def split(self, function: Callable[..., Any], in_specs: Any, out_specs: Any) -> Callable[..., Any]:
        """Return `function`, which is written for any number of members, as a function of all of them."""
        if self._mesh is None:
            return function
        # What varies between devices is not tracked: the physics' calls have no rule for it.
        return jax.shard_map(function, mesh=self._mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False)

    def put(self, tree: Any, spec: Any = FIRST_AXIS) -> Any:
        """Move a pytree to the devices, all of its leaves split in the same way."""
        if self._mesh is None:
            return self.gather(tree)
        return jax.device_put(tree, NamedSharding(self._mesh, spec))

    def gather(self, tree: Any) -> Any:
        """Move a pytree to the first of the devices."""
        return jax.device_put(tree, SingleDeviceSharding(self.devices[0]))


def state_specs(state: Any) -> Any:
    """Return how a training state is split, as a tree of its structure.

    Counters of updates are of all members. The carries of frozen partners are laid out [partner, member x simulation],
    everything else member by member.
    """
    specs = jax.tree.map(lambda leaf: FIRST_AXIS if leaf.ndim else WHOLE, state)
    carries = jax.tree.map(lambda _: SECOND_AXIS, state.simulations.partners)
    return dataclasses.replace(specs, simulations=dataclasses.replace(specs.simulations, partners=carries))
