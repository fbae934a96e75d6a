"""Hyperparameters of the trainers, and presets of algorithms, as data. Imports no JAX."""

import dataclasses
import types
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from assistax_base import extensions
from assistax_base.validated import Share, Widths, validated
from assistax_envs.preferences import WIDTH
from population.method_presets import METHODS, methods

LogStd = Annotated[float, Field(ge=-5, le=1)]


@validated
class Hyperparameters:
    """Hyperparameters that all trainers share."""

    num_envs: PositiveInt = 1024  # simulations of one member
    rollout_steps: PositiveInt = 64  # steps of each simulation between updates
    adam_eps: PositiveFloat = 1e-8  # added to Adam's denominator
    max_grad_norm: PositiveFloat = 0.5  # global norm to which each network's gradient is clipped
    torso: Literal["mlp", "gru"] = "mlp"  # "gru": actors and critics are recurrent
    hidden: Widths = (128, 128)  # widths of the hidden layers; (embedding, GRU) for "gru"
    activation: Literal["tanh", "relu"] = "tanh"  # after each dense hidden layer
    normalise: bool = True  # whether observations are normalised by running statistics
    initial_log_std: LogStd = -0.5  # log standard deviation of actions before training

    @property
    def batch_steps(self) -> int:
        """Environment steps of one member in one update."""
        return self.num_envs * self.rollout_steps

    @property
    def packages(self) -> dict[str, str]:
        """Versions of the installed packages that the trainer's method is of, by package."""
        return {}


@validated
class RewardHyperparameters(Hyperparameters):
    """Hyperparameters of the trainers that learn from rewards: PPO and SAC."""

    # Input of critics: that of their role (observation, and for SAC the action too), or everything.
    critic: Literal["local", "central"] = "local"
    gamma: Share = 0.99  # discount
    # Width of liking of the gentle tasks' rewards at the start. It falls linearly to the tasks' own
    # over the first half of the run: a narrow one pays nothing to a robot that knows nothing.
    liking_width: Annotated[float, Field(ge=WIDTH, le=2)] = WIDTH


@validated
class PPOConfig(RewardHyperparameters):
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
        "aux_coef",
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
    anneal_entropy: bool = False  # whether the bonuses of entropy and population fall likewise
    clip_eps: PositiveFloat = 0.31  # the probability ratio is clipped to [1 - eps, 1 + eps]
    entropy_coef: NonNegativeFloat = 1e-4  # weight of the entropy bonus
    # Weight of the reward for actions that are rare in the population. If above 0, the teams that
    # differ in their seed alone are one population.
    population_coef: NonNegativeFloat = 0.0
    value_coef: NonNegativeFloat = 1.0  # weight of the value loss
    gae_lambda: Share = 0.95  # decay of the advantage trace
    squash: Literal["clip", "tanh"] = "clip"  # how a Gaussian sample is brought into [-1, 1]
    # Log standard deviation: one vector, or a head on the torso.
    std: Literal["parameter", "state"] = "parameter"
    shared: bool = False  # whether one network acts for both roles, and one critic values for both
    method: str = ""  # addition to a robot's training: one of `methods`; "" adds nothing
    aux_coef: NonNegativeFloat = 1.0  # weight of the method's own loss
    # Width of the latent that a memory infers from observations and actions, an input of the
    # policy; 0 turns the memory off.
    latent: NonNegativeInt = 0
    kl_coef: NonNegativeFloat = 0.0  # weight of the latent's KL divergence in the method's loss
    # Episodes in a row with one partner and preference, over which a robot remembers and is paid.
    series: PositiveInt = 1
    student_share: Annotated[float, Field(ge=0, lt=1)] = 0.0  # of a run: its end, a student's

    @property
    def packages(self) -> dict[str, str]:
        """Versions of the installed packages that the trainer's method is of, by package."""
        if not self.method or self.method in METHODS:
            return {}
        extension = extensions.extensions(extensions.METHODS, METHODS)[self.method]
        return {extension.package: extension.version}

    def __post_init__(self) -> None:
        if self.method not in ("", *METHODS) and self.method not in (names := methods()):
            raise ValueError(
                f"method is {self.method!r}; allowed are {', '.join(names)}, and those that "
                "`population.methods.method.register` was given in this process"
            )
        if self.latent and (self.torso == "gru" or not self.method):
            raise ValueError(
                f"latent is {self.latent} with torso {self.torso!r} and method {self.method!r}; "
                "only a method trains a latent, whose policy is no gru: leave latent out"
            )
        if self.series > 1 and not (self.torso == "gru" or self.latent):
            raise ValueError(
                f"series is {self.series}, but without a memory a robot brings nothing into the "
                "next episode: choose torso gru, or leave series out"
            )
        if self.shared and self.torso == "gru" and len(self.hidden) < 2:
            raise ValueError(
                f"hidden is {self.hidden}; a shared recurrent network distinguishes the roles in "
                "its embedding, so give at least two widths, such as (128, 128)"
            )
        if self.population_coef and (self.shared or self.torso == "gru"):
            raise ValueError(
                f"population_coef is {self.population_coef} with shared={self.shared} and torso "
                f"{self.torso!r}; a population's humans have feed-forward networks of their own: "
                "leave shared and torso out"
            )
        check_minibatches(self.num_envs, self.minibatches)


def check_minibatches(num_envs: int, minibatches: int) -> None:
    """Raise ValueError if simulations cannot be divided into minibatches of whole ones."""
    if num_envs % minibatches:
        raise ValueError(
            f"num_envs is {num_envs} and minibatches {minibatches}; a minibatch holds whole "
            "simulations, so choose num_envs as a multiple of minibatches"
        )


@validated
class SACConfig(RewardHyperparameters):
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
    # Default of a run: updates are short, and a checkpoint holds the replay.
    checkpoint_every: ClassVar[int] = 2000
    updates_per_call: ClassVar[int] = 20  # default of a run

    num_envs: PositiveInt = 64  # simulations of one member
    rollout_steps: PositiveInt = 8  # steps of each simulation between updates
    # Transitions stored for each member, rounded up to whole rollouts.
    replay_size: PositiveInt = 1_000_000
    # Environment steps of a member with uniform actions and without learning.
    exploration_steps: NonNegativeInt = 5000
    batch_size: PositiveInt = 128  # transitions of one gradient step
    updates: PositiveInt = 32  # gradient steps of the critics after each rollout
    # Steps of the critics before the policy and the temperature take as many.
    policy_delay: PositiveInt = 4
    policy_lr: PositiveFloat = 3e-4  # learning rate of the actors
    q_lr: PositiveFloat = 1e-3  # learning rate of the critics
    alpha_lr: PositiveFloat = 3e-4  # learning rate of the temperature's logarithm
    max_grad_norm: PositiveFloat = 10.0  # global norm to which each network's gradient is clipped
    tau: Share = 0.005  # share of the critics in their slow copies at each step
    autotune: bool = True  # whether the temperature follows the target entropy
    initial_alpha: PositiveFloat = 0.1  # temperature at the start
    # The target entropy is -scale x action dimension, as in the public code that the tables' names
    # come from. At 5 it lies below what a Gaussian of the least standard deviation has, so the
    # temperature falls throughout a run.
    target_entropy_scale: float = 5.0
    population_coef: ClassVar[float] = 0.0
    latent: ClassVar[int] = 0
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


@validated
class DAggerConfig(Hyperparameters):
    """Hyperparameters of DAgger, by which a robot learns to act like one that is told."""

    kind: ClassVar[str] = "dagger"
    traced: ClassVar[tuple[str, ...]] = ("learning_rate", "max_grad_norm", "aux_coef")
    rates: ClassVar[tuple[str, ...]] = ("learning_rate",)
    checkpoint_every: ClassVar[int] = 20  # default of a run
    updates_per_call: ClassVar[int] = 1  # default of a run

    num_envs: PositiveInt = 512  # simulations of one member
    rollout_steps: PositiveInt = 128  # steps of each simulation between updates
    torso: Literal["mlp", "gru"] = "gru"  # what a robot is not told it has to remember
    epochs: PositiveInt = 4  # passes over a rollout
    minibatches: PositiveInt = 8  # parts of a pass; each holds whole simulations
    learning_rate: PositiveFloat = 1e-3  # of Adam
    anneal_lr: bool = True  # whether the learning rate falls linearly to 0 over the run
    # Weight of the error with which a gru's memory reads what the teacher is told.
    aux_coef: NonNegativeFloat = 0.05
    # What trainers that learn from rewards choose.
    critic: ClassVar[str] = "local"
    liking_width: ClassVar[float] = WIDTH
    population_coef: ClassVar[float] = 0.0
    latent: ClassVar[int] = 0
    squash: ClassVar[str] = "clip"
    std: ClassVar[str] = "parameter"

    def __post_init__(self) -> None:
        check_minibatches(self.num_envs, self.minibatches)


TrainerConfig = PPOConfig | SACConfig | DAggerConfig
KINDS: Mapping[str, type[PPOConfig] | type[SACConfig] | type[DAggerConfig]] = {
    "ppo": PPOConfig,
    "sac": SACConfig,
    "dagger": DAggerConfig,
}

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


def find_method(name: str) -> tuple[str | type, Mapping[str, Any]]:
    """Return a method's class, or its place, and the differences of its preset from PPO's.

    The class of an installed package is imported here, and has the differences as `preset`.

    Args:
        name: One of `methods`.

    Raises:
        assistax_base.extensions.ExtensionError: The package's class cannot be loaded, or has no
            such preset.
    """
    if name in METHODS:
        return METHODS[name]
    extension = extensions.extensions(extensions.METHODS, METHODS)[name]
    kind = extension.load()
    differences = getattr(kind, "preset", None)
    if not isinstance(kind, type) or not isinstance(differences, Mapping):
        raise extension.error("a subclass of `population.methods.method.Method`", repr(kind))
    try:
        _changed(name, "ppo", {"method": name}, differences)
    except ValueError as error:
        raise extension.error("a preset of PPO's hyperparameters", str(error)) from None
    return kind, differences


def preset(algorithm: str, **changes: Any) -> TrainerConfig:
    """Return the hyperparameters of an algorithm, a `PPOConfig` or a `SACConfig`, with changes.

    Raises:
        ValueError: If the algorithm or a changed field is unknown, or a value is not allowed.
    """
    if algorithm not in PRESETS:
        raise ValueError(f"algorithm is {algorithm!r}; allowed are {', '.join(PRESETS)}")
    return _changed(algorithm, *PRESETS[algorithm], changes)


def robot_preset(algorithm: str, **changes: Any) -> TrainerConfig:
    """Return the hyperparameters of a robot that trains with partners, with changes.

    Raises:
        ValueError: If the algorithm or a changed field is unknown, or a value is not allowed.
    """
    alone = {"ppo": "ippo", "sac": "isac"}  # the presets of teams, for one seat
    if algorithm in alone:
        return _changed(algorithm, *PRESETS[alone[algorithm]], changes)
    if algorithm == DAggerConfig.kind:
        return _changed(algorithm, algorithm, {}, changes)
    if algorithm not in (names := methods()):
        allowed = ", ".join((*alone, DAggerConfig.kind, *names))
        raise ValueError(f"algorithm is {algorithm!r}; allowed are {allowed}")
    home, differences = find_method(algorithm)
    return _changed(algorithm, "ppo", {"method": algorithm if home else "", **differences}, changes)


def _changed(
    algorithm: str, kind: str, differences: Mapping[str, Any], changes: Mapping[str, Any]
) -> TrainerConfig:
    """Return the trainer's config of a kind, with a preset's differences and then the changes."""
    fields = [field.name for field in dataclasses.fields(KINDS[kind])]
    if unknown := sorted(set(changes) - set(fields)):
        raise ValueError(
            f"unknown hyperparameter {', '.join(unknown)} of {algorithm}; allowed are "
            f"{', '.join(fields)}"
        )
    return KINDS[kind](**{**differences, **changes})
