"""What to train, as data: hyperparameters, presets of algorithms, members. Imports no JAX."""

import dataclasses
import math
import types
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from assistax_base.validated import Many, Share, Widths, validated
from assistax_envs.disability import DISABILITY_SETTINGS
from assistax_envs.preferences import check_preferences
from assistax_envs.versions import TASKS

# Stands for the disability setting of an ego, which trains with partners of several.
MIXED = "mixed"

LogStd = Annotated[float, Field(ge=-5, le=1)]
Precision = Literal["float32", "float16"]


@validated
class Hyperparameters:
    """What both trainers have."""

    # What critics see: of their role (observation, and SAC's the action too), or everything.
    critic: Literal["local", "central"] = "local"
    num_envs: PositiveInt = 1024  # simulations of one member
    rollout_steps: PositiveInt = 64  # steps of each simulation between updates
    adam_eps: PositiveFloat = 1e-8  # added to Adam's denominator
    max_grad_norm: PositiveFloat = 0.5  # global norm to which each network's gradient is clipped
    gamma: Share = 0.99  # discount
    torso: Literal["mlp", "gru"] = "mlp"  # "gru": actors and critics are recurrent
    hidden: Widths = (128, 128)  # widths of the hidden layers; (embedding, GRU) for "gru"
    activation: Literal["tanh", "relu"] = "tanh"  # after each dense hidden layer
    normalise: bool = True  # whether observations are normalised by running statistics
    initial_log_std: LogStd = -0.5  # log standard deviation of actions before training

    @property
    def batch_steps(self) -> int:
        """Environment steps of one member in one update."""
        return self.num_envs * self.rollout_steps


@validated
class PPOConfig(Hyperparameters):
    """Hyperparameters of PPO.

    The defaults are the paper's IPPO (appendix, hyperparameters of IPPO).
    """

    kind: ClassVar[str] = "ppo"
    # Traced, so that members of one program may differ in them.
    traced: ClassVar[tuple[str, ...]] = (
        "learning_rate",
        "clip_eps",
        "entropy_coef",
        "population_coef",
        "value_coef",
        "gamma",
        "gae_lambda",
        "max_grad_norm",
    )
    rates: ClassVar[tuple[str, ...]] = ("learning_rate",)
    checkpoint_every: ClassVar[int] = 20  # default of a run
    updates_per_call: ClassVar[int] = 1  # default of a run

    epochs: PositiveInt = 4  # passes over a rollout
    minibatches: PositiveInt = 4  # parts of a pass; each holds whole simulations
    learning_rate: PositiveFloat = 1e-3  # of Adam, for actors and critics
    anneal_lr: bool = False  # whether the learning rate falls linearly to 0 over the run
    anneal_entropy: bool = False  # whether the bonuses of entropy and of the population do
    clip_eps: PositiveFloat = 0.31  # the probability ratio is clipped to [1 - eps, 1 + eps]
    entropy_coef: NonNegativeFloat = 1e-4  # weight of the entropy bonus
    # Weight of the reward for what the population seldom does; above 0 the teams that differ in
    # their seed alone are one population.
    population_coef: NonNegativeFloat = 0.0
    value_coef: NonNegativeFloat = 1.0  # weight of the value loss
    gae_lambda: Share = 0.95  # decay of the advantage trace
    squash: Literal["clip", "tanh"] = "clip"  # how a Gaussian sample is brought into [-1, 1]
    std: Literal["parameter", "state"] = (
        "parameter"  # log standard deviation: one vector, or a head on the torso
    )
    shared: bool = False  # whether one network acts for both roles, and one critic values for both

    def __post_init__(self) -> None:
        if self.shared and self.torso == "gru" and len(self.hidden) < 2:
            raise ValueError(
                f"hidden is {self.hidden}; a shared recurrent network tells roles apart in its "
                "embedding, so give two widths at least, such as (128, 128)"
            )
        if self.population_coef and (self.shared or self.torso == "gru"):
            raise ValueError(
                f"population_coef is {self.population_coef} with shared={self.shared} and torso "
                f"{self.torso!r}; a population's humans have feed-forward networks of their own: "
                "leave shared and torso out"
            )
        if self.num_envs % self.minibatches:
            raise ValueError(
                f"num_envs is {self.num_envs} and minibatches {self.minibatches}; "
                "a minibatch holds whole simulations, so choose num_envs as a multiple of "
                "minibatches"
            )


@validated
class SACConfig(Hyperparameters):
    """Hyperparameters of SAC.

    The defaults are the paper's ISAC (appendix, hyperparameters of ISAC).
    """

    kind: ClassVar[str] = "sac"
    # Traced, so that members of one program may differ in them.
    traced: ClassVar[tuple[str, ...]] = (
        "policy_lr",
        "q_lr",
        "alpha_lr",
        "tau",
        "gamma",
        "target_entropy_scale",
        "max_grad_norm",
    )
    rates: ClassVar[tuple[str, ...]] = ("policy_lr", "q_lr", "alpha_lr")
    checkpoint_every: ClassVar[int] = (
        2000  # default of a run: updates are short, and a checkpoint holds the replay
    )
    updates_per_call: ClassVar[int] = 20  # default of a run

    num_envs: PositiveInt = 64  # simulations of one member
    rollout_steps: PositiveInt = 8  # steps of each simulation between updates
    replay_size: PositiveInt = (
        1_000_000  # transitions kept for each member, rounded up to whole rollouts
    )
    exploration_steps: NonNegativeInt = (
        5000  # environment steps of a member with uniform actions and without learning
    )
    batch_size: PositiveInt = 128  # transitions of one gradient step
    updates: PositiveInt = 32  # gradient steps of the critics after each rollout
    policy_delay: PositiveInt = (
        4  # critics take this many steps, then the policy and the temperature catch up
    )
    policy_lr: PositiveFloat = 3e-4  # learning rate of the actors
    q_lr: PositiveFloat = 1e-3  # learning rate of the critics
    alpha_lr: PositiveFloat = 3e-4  # learning rate of the temperature's logarithm
    max_grad_norm: PositiveFloat = (
        10.0  # global norm to which the gradient of each network is clipped
    )
    tau: Share = 0.005  # share of the critics in their slow copies at each step
    autotune: bool = True  # whether the temperature follows the target entropy
    initial_alpha: PositiveFloat = 0.1  # temperature at the start
    # The target entropy is -scale x action dimension, as in the public code that the tables' names
    # come from. At 5 it lies below what a Gaussian of the least standard deviation has, so the
    # temperature falls throughout a run.
    target_entropy_scale: float = 5.0
    population_coef: ClassVar[float] = 0.0
    squash: ClassVar[str] = "tanh"
    std: ClassVar[str] = "state"
    activation: Literal["tanh", "relu"] = "relu"  # after each hidden layer

    def __post_init__(self) -> None:
        if self.torso == "gru":
            raise ValueError(
                "torso is 'gru'; SAC is feed-forward only, because its replay keeps no recurrent "
                "states: train ippo or mappo with torso=gru"
            )
        if self.updates % self.policy_delay:
            raise ValueError(
                f"updates is {self.updates} and policy_delay {self.policy_delay}; "
                "the policy catches up after each policy_delay of them, so choose updates as a "
                "multiple of it"
            )
        if self.replay_size < self.batch_steps:
            raise ValueError(
                f"replay_size is {self.replay_size}; a rollout has {self.batch_steps} transitions, "
                "so choose at least that many"
            )


TrainerConfig = PPOConfig | SACConfig
_KINDS: Mapping[str, type[PPOConfig] | type[SACConfig]] = {"ppo": PPOConfig, "sac": SACConfig}

# The paper's tables, as differences from the defaults of the trainer. PPO's "scale clip eps" and
# "ratio clip eps" are off in both: the clip range is neither divided by the number of agents nor
# made symmetric in the ratio's logarithm. `mep` is our IPPO with the bonus of Zhao et al. (2023).
PRESETS: Mapping[str, tuple[str, Mapping[str, Any]]] = types.MappingProxyType(
    {
        "ippo": ("ppo", {}),
        "mappo": (
            "ppo",
            {
                "critic": "central",
                "rollout_steps": 128,
                "learning_rate": 4.4e-3,
                "entropy_coef": 2.7e-4,
                "clip_eps": 0.11,
            },
        ),
        "isac": ("sac", {}),
        "masac": ("sac", {"critic": "central", "q_lr": 2e-4}),
        "mep": ("ppo", {"population_coef": 1e-2}),
    }
)


def preset(algorithm: str, **changes: Any) -> TrainerConfig:
    """Return the hyperparameters of an algorithm, a `PPOConfig` or a `SACConfig`, with changes.

    Raises:
        ValueError: If the algorithm or a changed field is unknown, or a value is not allowed.
    """
    if algorithm not in PRESETS:
        raise ValueError(f"algorithm is {algorithm!r}; allowed are {', '.join(PRESETS)}")
    kind, differences = PRESETS[algorithm]
    fields = [field.name for field in dataclasses.fields(_KINDS[kind])]
    if unknown := sorted(set(changes) - set(fields)):
        raise ValueError(
            f"unknown hyperparameter {', '.join(unknown)} of {algorithm}; allowed are "
            f"{', '.join(fields)}"
        )
    return _KINDS[kind](**{**differences, **changes})


@validated
class Member:
    """A team in training, robot and human together, or one ego that learns with partners."""

    # Draws its networks, its resets and its actions.
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    # The human's setting, "d1".."d9"; "mixed" for an ego, whose partners each have their own.
    disability: str
    # Its own values of traced hyperparameters.
    overrides: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def label(self) -> str:
        """Short name within a run."""
        return f"{self.disability}-s{self.seed}"


@validated
class TrainConfig:
    """A run: its members train side by side in one compiled program."""

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
    # What their humans like, in turns; all, drawn anew each episode, if none are named.
    preferences: Many[str] = ()
    precision: Precision = "float32"  # of the parameters that are written, and then evaluated

    def __post_init__(self) -> None:
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
        """Refuse members that form no populations of one size, where the trainer wants them."""
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
    def updates(self) -> int:
        """Number of updates of the run."""
        return math.ceil(self.steps / self.trainer.batch_steps)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the members, "task/algorithm-setting-sN"."""
        return tuple(f"{self.task}/{self.algorithm}-{member.label}" for member in self.members)

    def to_json(self) -> dict[str, Any]:
        """Return JSON-ready values; `TrainConfig.from_json` gives the config back."""
        told = {**dataclasses.asdict(self), "kind": self.trainer.kind}
        if not self.preferences:  # as in runs of before there were any
            del told["preferences"]
        if self.precision == "float32":
            del told["precision"]
        return told

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "TrainConfig":
        """Return the config that `to_json` described."""
        fields: dict[str, Any] = dict(data)
        fields["members"] = tuple(Member(**member) for member in fields["members"])
        fields["trainer"] = _KINDS[fields.pop("kind")](**fields["trainer"])
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
) -> TrainConfig:
    """Return a run; what is None is the trainer's own."""
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
    )


def traced_values(config: TrainerConfig, members: Sequence[Member]) -> dict[str, list[float]]:
    """Return every traced hyperparameter of every member: the config's, or its own."""
    return {
        name: [member.overrides.get(name, getattr(config, name)) for member in members]
        for name in config.traced
    }


def populations(members: Sequence[Member]) -> list[list[int]]:
    """Return the places of the members of each population: those that differ in seed alone."""
    found: dict[Any, list[int]] = {}
    for place, member in enumerate(members):
        key = member.disability, *sorted(member.overrides.items())
        found.setdefault(key, []).append(place)
    return list(found.values())


def numbered(seeds: Any) -> Any:
    """Return the seeds that a number of them stands for, 0 to that number - 1; others as given."""
    return range(seeds) if type(seeds) is int else seeds


def make_members(seeds: Sequence[int], disabilities: Sequence[str]) -> tuple[Member, ...]:
    """Return every seed with every disability setting, setting by setting."""
    return tuple(Member(seed, disability) for disability in disabilities for seed in seeds)


def check_names(task: str, disabilities: Sequence[str] = ()) -> None:
    """Refuse an unknown task or disability setting before anything slow is imported."""
    if task not in TASKS:
        raise ValueError(f"task is {task!r}; allowed are {', '.join(TASKS)}")
    if unknown := [name for name in disabilities if name not in DISABILITY_SETTINGS]:
        raise ValueError(
            f"disability is {unknown[0]!r}; allowed are {', '.join(DISABILITY_SETTINGS)}"
        )
