"""What to train, as data: hyperparameters, presets of algorithms, members. Imports no JAX."""

import dataclasses
import math
import types
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

MIXED = (
    "mixed"  # stands for the disability setting of an ego, which trains with partners of several
)


@dataclasses.dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO.

    The defaults are the paper's IPPO (appendix, hyperparameters of IPPO).
    """

    kind: ClassVar[str] = "ppo"
    # Traced, so that members of one program may differ in them.
    traced: ClassVar[tuple[str, ...]] = (
        "learning_rate",
        "clip_eps",
        "entropy_coef",
        "value_coef",
        "gamma",
        "gae_lambda",
        "max_grad_norm",
    )
    rates: ClassVar[tuple[str, ...]] = ("learning_rate",)
    checkpoint_every: ClassVar[int] = 20  # default of a run
    updates_per_call: ClassVar[int] = 1  # default of a run

    critic: Literal["local", "central"] = (
        "local"  # what critics see: the role's observation, or the global one
    )
    num_envs: int = 1024  # simulations of one member
    rollout_steps: int = 64  # steps of each simulation between updates
    epochs: int = 4  # passes over a rollout
    minibatches: int = 4  # parts of a pass; each holds whole simulations
    learning_rate: float = 1e-3  # of Adam, for actors and critics
    anneal_lr: bool = False  # whether the learning rate falls linearly to 0 over the run
    adam_eps: float = 1e-8  # added to Adam's denominator
    max_grad_norm: float = 0.5  # global norm to which the gradient of each network is clipped
    clip_eps: float = 0.31  # the probability ratio is clipped to [1 - eps, 1 + eps]
    entropy_coef: float = 1e-4  # weight of the entropy bonus
    value_coef: float = 1.0  # weight of the value loss
    gamma: float = 0.99  # discount
    gae_lambda: float = 0.95  # decay of the advantage trace
    torso: Literal["mlp", "gru"] = "mlp"  # "gru": actors and critics are recurrent
    hidden: tuple[int, ...] = (128, 128)  # widths of the hidden layers; (embedding, GRU) for "gru"
    activation: Literal["tanh", "relu"] = "tanh"  # after each dense hidden layer
    squash: Literal["clip", "tanh"] = "clip"  # how a Gaussian sample is brought into [-1, 1]
    std: Literal["parameter", "state"] = (
        "parameter"  # log standard deviation: one vector, or a head on the torso
    )
    normalise: bool = True  # whether observations are normalised by running statistics
    initial_log_std: float = -0.5  # log standard deviation of actions before training
    shared: bool = False  # whether one network acts for both roles, and one critic values for both

    def __post_init__(self) -> None:
        _check_hidden(self)
        _check_choices(
            self, critic=("local", "central"), torso=("mlp", "gru"), activation=("tanh", "relu")
        )
        _check_choices(self, squash=("clip", "tanh"), std=("parameter", "state"))
        for name in ("num_envs", "rollout_steps", "epochs", "minibatches"):
            _check(
                isinstance(getattr(self, name), int) and getattr(self, name) >= 1,
                self,
                name,
                "an integer above 0",
            )
        for name in ("learning_rate", "adam_eps", "max_grad_norm", "clip_eps"):
            _check(_positive(getattr(self, name)), self, name, "a positive number")
        for name in ("entropy_coef", "value_coef"):
            _check(
                getattr(self, name) == 0 or _positive(getattr(self, name)),
                self,
                name,
                "0 or a positive number",
            )
        for name in ("gamma", "gae_lambda"):
            _check(
                _number(getattr(self, name)) and 0 <= getattr(self, name) <= 1,
                self,
                name,
                "a number in [0, 1]",
            )
        _check_log_std(self)
        for name in ("anneal_lr", "normalise", "shared"):
            _check(isinstance(getattr(self, name), bool), self, name, "true or false")
        if self.shared and self.torso == "gru" and len(self.hidden) < 2:
            raise ValueError(
                f"hidden is {self.hidden}; a shared recurrent network tells roles apart in its "
                "embedding, so give two widths at least, such as (128, 128)"
            )
        if self.num_envs % self.minibatches:
            raise ValueError(
                f"num_envs is {self.num_envs} and minibatches {self.minibatches}; "
                "a minibatch holds whole simulations, so choose num_envs as a multiple of "
                "minibatches"
            )

    @property
    def batch_steps(self) -> int:
        """Environment steps of one member in one update."""
        return self.num_envs * self.rollout_steps


@dataclasses.dataclass(frozen=True)
class SACConfig:
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

    critic: Literal["local", "central"] = (
        "local"  # critics see the role's observation and action, or everything
    )
    num_envs: int = 64  # simulations of one member
    rollout_steps: int = 8  # steps of each simulation between updates
    replay_size: int = 1_000_000  # transitions kept for each member, rounded up to whole rollouts
    exploration_steps: int = (
        5000  # environment steps of a member with uniform actions and without learning
    )
    batch_size: int = 128  # transitions of one gradient step
    updates: int = 32  # gradient steps of the critics after each rollout
    policy_delay: int = (
        4  # critics take this many steps, then the policy and the temperature catch up
    )
    policy_lr: float = 3e-4  # learning rate of the actors
    q_lr: float = 1e-3  # learning rate of the critics
    alpha_lr: float = 3e-4  # learning rate of the temperature's logarithm
    adam_eps: float = 1e-8  # added to Adam's denominator
    max_grad_norm: float = 10.0  # global norm to which the gradient of each network is clipped
    tau: float = 0.005  # share of the critics in their slow copies at each step
    gamma: float = 0.99  # discount
    autotune: bool = True  # whether the temperature follows the target entropy
    initial_alpha: float = 0.1  # temperature at the start
    # The target entropy is -scale x action dimension, as in the public code that the tables' names
    # come from. At 5 it lies below what a Gaussian of the least standard deviation has, so the
    # temperature falls throughout a run.
    target_entropy_scale: float = 5.0
    squash: ClassVar[str] = "tanh"
    std: ClassVar[str] = "state"
    torso: Literal["mlp"] = "mlp"  # feed-forward only
    hidden: tuple[int, ...] = (128, 128)  # widths of the hidden layers
    activation: Literal["tanh", "relu"] = "relu"  # after each hidden layer
    normalise: bool = True  # whether observations are normalised by running statistics
    initial_log_std: float = -0.5  # log standard deviation of actions before training

    def __post_init__(self) -> None:
        if self.torso == "gru":
            raise ValueError(
                "torso is 'gru'; SAC is feed-forward only, because its replay keeps no recurrent "
                "states: train ippo or mappo with torso=gru"
            )
        _check_hidden(self)
        _check_choices(
            self, critic=("local", "central"), torso=("mlp",), activation=("tanh", "relu")
        )
        for name in (
            "num_envs",
            "rollout_steps",
            "replay_size",
            "batch_size",
            "updates",
            "policy_delay",
        ):
            _check(
                isinstance(getattr(self, name), int) and getattr(self, name) >= 1,
                self,
                name,
                "an integer above 0",
            )
        steps = self.exploration_steps
        _check(isinstance(steps, int) and steps >= 0, self, "exploration_steps", "0 or more")
        for name in ("policy_lr", "q_lr", "alpha_lr", "adam_eps", "max_grad_norm", "initial_alpha"):
            _check(_positive(getattr(self, name)), self, name, "a positive number")
        _check(_number(self.target_entropy_scale), self, "target_entropy_scale", "a number")
        for name in ("gamma", "tau"):
            _check(
                _number(getattr(self, name)) and 0 <= getattr(self, name) <= 1,
                self,
                name,
                "a number in [0, 1]",
            )
        _check_log_std(self)
        for name in ("autotune", "normalise"):
            _check(isinstance(getattr(self, name), bool), self, name, "true or false")
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

    @property
    def batch_steps(self) -> int:
        """Environment steps of one member in one update."""
        return self.num_envs * self.rollout_steps


TrainerConfig = PPOConfig | SACConfig
_KINDS: Mapping[str, type[PPOConfig] | type[SACConfig]] = {"ppo": PPOConfig, "sac": SACConfig}

# The paper's tables, as differences from the defaults of the trainer. PPO's "scale clip eps" and
# "ratio clip eps" are off in both: the clip range is neither divided by the number of agents nor
# made symmetric in the ratio's logarithm.
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


@dataclasses.dataclass(frozen=True)
class Member:
    """A team in training, robot and human together, or one ego that learns with partners."""

    seed: int  # draws its networks, its resets and its actions
    # The human's setting, "d1".."d9"; "mixed" for an ego, whose partners each have their own.
    disability: str
    overrides: Mapping[str, float] = dataclasses.field(
        default_factory=dict
    )  # its own values of traced hyperparameters

    def __post_init__(self) -> None:
        _check(
            isinstance(self.seed, int) and 0 <= self.seed < 2**31,
            self,
            "seed",
            "an integer from 0 to 2^31 - 1",
        )

    @property
    def label(self) -> str:
        """Short name within a run."""
        return f"{self.disability}-s{self.seed}"


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """A run: its members train side by side in one compiled program."""

    task: str  # environment task
    algorithm: str  # name under which the teams are listed
    members: tuple[Member, ...]  # the teams
    steps: int  # environment steps of each member, rounded up to whole updates
    trainer: TrainerConfig = dataclasses.field(
        default_factory=PPOConfig
    )  # hyperparameters; their kind is the trainer
    checkpoint_every: int = 20  # updates between checkpoints
    updates_per_call: int = 1  # updates dispatched to the device at once
    self_play_episodes: int = 16  # episodes of each team's final evaluation; 0 leaves it out
    partners: tuple[
        str, ...
    ] = ()  # names of the frozen partners of an ego's training; none: teams learn together

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        object.__setattr__(self, "partners", tuple(self.partners))
        for name in ("steps", "checkpoint_every", "updates_per_call"):
            _check(
                isinstance(getattr(self, name), int) and getattr(self, name) >= 1,
                self,
                name,
                "an integer above 0",
            )
        _check(self.self_play_episodes >= 0, self, "self_play_episodes", "0 or more")
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

    @property
    def updates(self) -> int:
        """Number of updates of the run."""
        return math.ceil(self.steps / self.trainer.batch_steps)

    def to_json(self) -> dict[str, Any]:
        """Return JSON-ready values; `TrainConfig.from_json` gives the config back."""
        return {**dataclasses.asdict(self), "kind": self.trainer.kind}

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
    )


def traced_values(config: TrainerConfig, members: Sequence[Member]) -> dict[str, list[float]]:
    """Return every traced hyperparameter of every member: the config's, or its own."""
    return {
        name: [member.overrides.get(name, getattr(config, name)) for member in members]
        for name in config.traced
    }


def make_members(seeds: Sequence[int], disabilities: Sequence[str]) -> tuple[Member, ...]:
    """Return every seed with every disability setting, setting by setting."""
    return tuple(Member(seed, disability) for disability in disabilities for seed in seeds)


def _check_hidden(config: TrainerConfig) -> None:
    if isinstance(config.hidden, list):
        object.__setattr__(config, "hidden", tuple(config.hidden))
    widths = isinstance(config.hidden, tuple) and all(
        isinstance(width, int) and width > 0 for width in config.hidden
    )
    _check(
        widths and len(config.hidden) > 0, config, "hidden", "a tuple of widths, such as (128, 128)"
    )


def _check_log_std(config: TrainerConfig) -> None:
    value = config.initial_log_std
    _check(_number(value) and -5 <= value <= 1, config, "initial_log_std", "a number in [-5, 1]")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _positive(value: Any) -> bool:
    return _number(value) and 0 < value < math.inf


def _check(valid: bool, config: object, name: str, allowed: str) -> None:
    if not valid:
        raise ValueError(f"{name} is {getattr(config, name)!r}; it must be {allowed}")


def _check_choices(config: object, **choices: tuple[str, ...]) -> None:
    for name, allowed in choices.items():
        if getattr(config, name) not in allowed:
            raise ValueError(
                f"{name} is {getattr(config, name)!r}; allowed are {', '.join(allowed)}"
            )
