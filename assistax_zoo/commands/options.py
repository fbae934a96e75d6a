"""Groups of options that several commands share."""

import ast
import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from assistax_base.cluster import RayCluster

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "b": 10**9}


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Source:
    """Source of the policies.

    Attributes:
        registry: Registry to read instead of the installed one: a file, a folder or an address.
        lock: Lock file of a paper; partners, bytes and splits other than those it pins are refused.
    """

    registry: str | None = None
    lock: Path | None = None

    def given(self) -> dict[str, Any]:
        """Return the options as arguments of the functions of `assistax_zoo`."""
        return {"zoo": self.registry, "lock": self.lock}


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Page:
    """Size and captions of a figure on a page.

    Attributes:
        width: Inches of the figure, such as 3.3 for a column; no letter is below 4 points.
        bare: Leave out title and caption, for a text that has its own.
    """

    width: float | None = None
    bare: bool = False

    def given(self) -> dict[str, Any]:
        """Return the options as arguments of the functions of `evaluation.plots.figures`."""
        return dataclasses.asdict(self)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class PartnerChoice:
    """Choice of the partners of an evaluation, and of the references beside its robots.

    Attributes:
        split: Sides of a split whose partners play: test (default), train or both sides of the
            default split, or the id of another split (ID:both). Persons and splits of three sides
            have validation too.
        partners: Glob over partners, or several, such as `'scratch/ippo-d9-*'`: only matching
            partners of those sides play. If all of them are of one release, its default split is
            meant. persons for persons, or a glob such as `'gentle_scratch/person-08*'`; teams
            may be named beside them.
        persons: Number of persons to draw. Default 200.
        include_own: Count partners that were trained with one of the robots. Without this they play
            and stand in the tables, and figures leave them out.
        trained_with: Training partners of the robots, if neither the zoo nor the robots' files name
            them: nobody, or one or several of split ids, each for its training side, and globs over
            partners.
        references: Compare with zero and random actions, the task's script and each partner's own
            robot, and play with a human that does nothing. Their results are kept for later
            evaluations.
        crossplay: Finished cross-play, whose best robots may be the partners' best responses.
    """

    split: str | None = None
    partners: tuple[str, ...] = ()
    persons: int | None = None
    include_own: bool = False
    trained_with: tuple[str, ...] = ()
    references: bool = True
    crossplay: Path | None = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Engine:
    """Engine that runs the blocks of a command.

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
        """Return the Ray cluster of the options; None for the engine "local".

        Raises:
            ValueError: An option of Ray is given without `engine` "ray", or has a wrong value.
        """
        from assistax_base.cluster import RayCluster

        names = ("ray_address", "ray_cpus", "ray_gpus")
        options = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if self.engine == "ray":
            return RayCluster(
                **{name.removeprefix("ray_"): value for name, value in options.items()}
            )
        if options:
            raise ValueError(
                f"{', '.join('--' + name.replace('_', '-') for name in options)} needs --engine ray"
            )
        return None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Training:
    """Settings of a training run.

    Attributes:
        seeds: How many, numbered from 0, or which: 8, 0-7 or 2,5.
        backend: Physics: fused, native, mjx, mjx-warp, or auto for the fastest one.
        num_envs: Simulations of each team or robot; default the preset's, or the nearest to it that
            frozen partners can share.
        set_: Another hyperparameter, such as learning_rate=3e-4, torso=gru or shared=true; repeat
            it for more.
        checkpoint_every: Updates between checkpoints; default 20 for PPO, 2000 for SAC, whose
            updates are short.
        updates_per_call: Updates dispatched to the device at once; default 1 for PPO, 20 for SAC.
        resume: Continue the run that the folder holds.
        tensorboard: Where to show it: a folder for TensorBoard event files, which several runs may
            share, or wandb:PROJECT; needs assistax-zoo[tensorboard] or assistax-zoo[wandb].
    """

    seeds: str = "1"
    backend: str = "auto"
    num_envs: int | None = None
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = ()
    checkpoint_every: int | None = None
    updates_per_call: int | None = None
    resume: bool = True
    tensorboard: Annotated[str | None, Parameter(name="--log")] = None

    def what(self, steps: str, changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the settings of the learning as arguments of the training functions.

        Args:
            steps: Environment steps, as they were typed.
            changes: Hyperparameters that `--set` may override.
        """
        changes = {**(changes or {}), **parse_changes(self.set_)}
        if self.num_envs is not None:
            changes["num_envs"] = self.num_envs
        return {
            "seeds": parse_seeds(self.seeds),
            "steps": parse_steps(steps),
            "hyperparameters": changes,
            "checkpoint_every": self.checkpoint_every,
            "updates_per_call": self.updates_per_call,
        }

    def how(self) -> dict[str, Any]:
        """Return the backend and the output as arguments of the training functions."""
        return {
            "backend": self.backend,
            "resume": self.resume,
            "tensorboard": self.tensorboard,
        }


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Choosing:
    """Choice of checkpoints and seeds by the validation side of a split.

    Attributes:
        validate: At how many equal steps the robots are kept, and then play with the validation
            side, which chooses each seed's checkpoint; default none.
        best_of: Choose also the best of each so many seeds.
    """

    validate: int = 0
    best_of: int = 4


def parse_steps(text: str) -> int:
    """Return a number of steps written as 250000, 500k, 10M or 2e7."""
    match = re.fullmatch(
        r"([0-9]+(?:\.[0-9]*)?(?:[eE][0-9]{1,2})?)([kmgb]?)", text.strip(), re.IGNORECASE
    )
    steps = float(match[1]) * _UNITS[match[2].lower()] if match else 0.0
    if not 1.0 <= steps < 1e15:
        raise ValueError(f"steps is {text!r}; give a number above 0, such as 500k, 10M or 2e7")
    return math.ceil(steps)


def parse_names(text: str | None) -> list[str]:
    """Return the names of "p1,p5"; an empty list if there is no text."""
    return text.split(",") if text else []


def parse_seeds(text: str) -> list[int]:
    """Return the seeds of "8" (0 to 7), "0-7" or "2,5"."""
    ranges = [re.fullmatch(r"(\d+)(?:-(\d+))?", part.strip()) for part in text.split(",")]
    if text.strip().isdigit():
        seeds = list(range(int(text)))
    else:
        seeds = [seed for r in ranges if r for seed in range(int(r[1]), int(r[2] or r[1]) + 1)]
    if not seeds or not all(ranges) or len(set(seeds)) < len(seeds):
        raise ValueError(
            f"seeds is {text!r}; give how many, such as 8, or which, such as 0-7 or 2,5, each once"
        )
    return seeds


def parse_changes(words: Sequence[str]) -> dict[str, Any]:
    """Return the hyperparameters of words such as "learning_rate=3e-4"."""
    changes = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals or not name:
            raise ValueError(f"--set is {word!r}; give name=value, such as learning_rate=3e-4")
        try:
            changes[name.strip()] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            changes[name.strip()] = {"true": True, "false": False}.get(value.lower(), value)
    return changes
