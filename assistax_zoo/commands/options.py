"""Options that several commands share, each group flattened into a command's own."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from population.ray_blocks import RayCluster


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Playing:
    """How egos play with partners.

    Attributes:
        episodes: Episodes of each pair.
        seed: Seed of the episodes, the same for every pair.
        backend: native, mjx, mjx-warp, or auto for the fastest here.
        stochastic: Draw actions instead of taking each policy's most likely one.
        max_envs: Most simulations in a saved part, and on a GPU at once; lower it if memory runs
            out.
    """

    episodes: int = 8
    seed: int = 0
    backend: str = "auto"
    stochastic: bool = False
    max_envs: int | None = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Source:
    """Where policies come from.

    Attributes:
        registry: Registry to read instead of the installed one: a file, a folder or an address.
        lock: Lock file of a paper; partners, bytes and splits other than those it pins are refused.
    """

    registry: str | None = None
    lock: Path | None = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Engine:
    """What runs the blocks of a command.

    Attributes:
        engine: local: one after another here; ray: over a Ray cluster, whose workers need this code
            and the same --out.
        ray_address: Running cluster, such as auto or head:6379; default a local one for this
            command.
        ray_cpus: CPUs that a block takes; default a whole machine's, or 1 with --ray-gpus.
        ray_gpus: GPUs that a block takes, such as 1, or 0.5 for two on one GPU; default 0.
    """

    engine: Literal["local", "ray"] = "local"
    ray_address: str | None = None
    ray_cpus: float | None = None
    ray_gpus: float | None = None

    def cluster(self) -> "RayCluster | None":
        """Return the cluster that was asked for.

        Raises:
            ValueError: An option of Ray is given without it, or has a wrong value.
        """
        from population.ray_blocks import RayCluster

        names = ("ray_address", "ray_cpus", "ray_gpus")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if self.engine == "ray":
            return RayCluster(**{name.removeprefix("ray_"): value for name, value in given.items()})
        if given:
            raise ValueError(
                f"{', '.join('--' + name.replace('_', '-') for name in given)} needs --engine ray"
            )
        return None
