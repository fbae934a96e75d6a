"""Configuration of a training run: its members and their length. Imports no JAX."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeInt, PositiveInt

from assistax_base.validated import Many, validated
from assistax_envs.disability import DISABILITY_SETTINGS
from assistax_envs.preferences import PREFERRED, Told, check_preferences
from assistax_envs.versions import TASKS
from population.hyperparameters import KINDS, PPOConfig, TrainerConfig
from population.views import CLAIM, View

# Stands for the disability setting of an ego, which trains with partners of several.
MIXED = "mixed"

Precision = Literal["float32", "float16"]


@validated
class Member:
    """A team in training, robot and human together, or one ego that learns with partners."""

    # Seeds the networks, the resets and the actions.
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    # The human's setting, "d1".."d9"; "mixed" for an ego, whose partners each have their own.
    disability: str
    # Values of traced hyperparameters that differ from the run's.
    overrides: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def label(self) -> str:
        """Short name within a run."""
        return f"{self.disability}-s{self.seed}"


@validated
class TrainConfig:
    """Configuration of a run, whose members train side by side in one compiled program."""

    task: str  # environment task
    algorithm: str  # name under which the teams are listed
    members: Many[Member]  # the teams
    steps: PositiveInt  # environment steps of each member, rounded up to whole updates
    # Hyperparameters; their kind is the trainer.
    trainer: TrainerConfig = dataclasses.field(default_factory=PPOConfig)
    checkpoint_every: PositiveInt = 20  # updates between checkpoints
    updates_per_call: PositiveInt = 1  # updates dispatched to the device at once
    self_play_episodes: NonNegativeInt = 16  # of each team's final evaluation; 0 leaves it out
    # Names of the frozen partners of an ego's training; without any, teams learn together.
    partners: Many[str] = ()
    # Preferences of the partners' humans, in turns; if empty, one of all is drawn each episode.
    preferences: Many[str] = ()
    precision: Precision = "float32"  # of the parameters that are written, and then evaluated
    env_version: PositiveInt | None = None  # of the environment; the newest if not given
    told: Told = False
    # Digests of what decides the run beside these fields, by name: of the partners, their split.
    key: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.told and not (self.partners and self.task in PREFERRED):
            raise ValueError(
                f"told is for robots that train with partners in a task of {', '.join(PREFERRED)}; "
                f"{self.task} has no preference to tell: leave told out"
            )
        if self.preferences:
            check_preferences(self.task, self.preferences)
            if not self.partners:
                raise ValueError(
                    "preferences are those of frozen partners; a team's are drawn, leave them out"
                )
        if not self.members:
            raise ValueError(
                "a run has no members; give at least one seed and one disability setting"
            )
        traced = self.trainer.traced
        if unknown := sorted(
            {name for member in self.members for name in member.overrides} - set(traced)
        ):
            raise ValueError(
                f"a member overrides {', '.join(unknown)}; members may differ in "
                f"{', '.join(traced)}"
            )
        distinct = {(member.label, *sorted(member.overrides.items())) for member in self.members}
        if len(distinct) < len(self.members):
            raise ValueError(
                "two members of a run are identical; each (seed, disability, overrides) may appear "
                "once"
            )
        self._check_populations()

    def _check_populations(self) -> None:
        """Refuse populations of unequal sizes, or of one member, if there is a bonus for them."""
        if not self.trainer.population_coef:
            if any("population_coef" in member.overrides for member in self.members):
                raise ValueError(
                    "members override population_coef, but it is 0 in the run, which then has no "
                    "populations; set it above 0"
                )
            return
        if self.partners:
            raise ValueError(
                "population_coef is for teams, and an ego's partners are frozen; set it to 0"
            )
        sizes = {len(places) for places in populations(self.members)}
        if len(sizes) > 1 or min(sizes) < 2:
            raise ValueError(
                f"{self.algorithm} trains the seeds of a setting as one population, and the run "
                f"has populations of {sorted(sizes)}; give every setting the same number of "
                "seeds, two at least"
            )

    @property
    def view(self) -> View:
        """Observations of the robots in training."""
        return View.of_told(self.told)

    @property
    def updates(self) -> int:
        """Number of updates of the run."""
        return math.ceil(self.steps / self.trainer.batch_steps)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the members, "task/algorithm-setting-sN"."""
        return tuple(f"{self.task}/{self.algorithm}-{member.label}" for member in self.members)

    def to_json(self) -> dict[str, Any]:
        """Return JSON-ready values; `TrainConfig.from_json` gives the config back."""
        content = {**dataclasses.asdict(self), "kind": self.trainer.kind}
        # Default values are left out, so that runs of before these fields keep their digest.
        if not self.preferences:
            del content["preferences"]
        if self.precision == "float32":
            del content["precision"]
        if self.env_version is None:
            del content["env_version"]
        if self.view is View.PLAIN:
            del content[CLAIM]
        return content

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "TrainConfig":
        """Return the config of a value that `to_json` returned."""
        fields: dict[str, Any] = dict(data)
        fields["members"] = tuple(Member(**member) for member in fields["members"])
        fields["trainer"] = KINDS[fields.pop("kind")](**fields["trainer"])
        return cls(**fields)


def make_run(
    task: str,
    algorithm: str,
    members: Sequence[Member],
    steps: int,
    trainer: TrainerConfig,
    *,
    checkpoint_every: int | None = None,
    updates_per_call: int | None = None,
    self_play_episodes: int = 16,
    partners: Sequence[str] = (),
    preferences: Sequence[str] = (),
    precision: Precision = "float32",
    env_version: int | None = None,
) -> TrainConfig:
    """Return a run's config; an argument of None takes the trainer's default."""
    return TrainConfig(
        task=task,
        algorithm=algorithm,
        members=tuple(members),
        steps=steps,
        trainer=trainer,
        checkpoint_every=trainer.checkpoint_every if checkpoint_every is None else checkpoint_every,
        updates_per_call=trainer.updates_per_call if updates_per_call is None else updates_per_call,
        self_play_episodes=self_play_episodes,
        partners=tuple(partners),
        preferences=tuple(preferences),
        precision=precision,
        env_version=env_version,
    )


def traced_values(config: TrainerConfig, members: Sequence[Member]) -> dict[str, list[float]]:
    """Return the values of each traced hyperparameter by name, one for each member."""
    return {
        name: [member.overrides.get(name, getattr(config, name)) for member in members]
        for name in config.traced
    }


def populations(members: Sequence[Member]) -> list[list[int]]:
    """Return the indices of each population's members, which differ in their seed alone."""
    places: dict[Any, list[int]] = {}
    for place, member in enumerate(members):
        key = member.disability, *sorted(member.overrides.items())
        places.setdefault(key, []).append(place)
    return list(places.values())


def numbered(seeds: Any) -> Any:
    """Return `range(seeds)` for an integer; return any other value unchanged."""
    return range(seeds) if type(seeds) is int else seeds


def make_members(seeds: Sequence[int], disabilities: Sequence[str]) -> tuple[Member, ...]:
    """Return a member for each pair of seed and disability setting, setting by setting."""
    return tuple(Member(seed, disability) for disability in disabilities for seed in seeds)


def check_names(task: str, disabilities: Sequence[str] = ()) -> None:
    """Raise ValueError for an unknown task or disability setting, before slow imports."""
    if task not in TASKS:
        raise ValueError(f"task is {task!r}; allowed are {', '.join(TASKS)}")
    if unknown := [name for name in disabilities if name not in DISABILITY_SETTINGS]:
        raise ValueError(
            f"disability is {unknown[0]!r}; allowed are {', '.join(DISABILITY_SETTINGS)}"
        )
