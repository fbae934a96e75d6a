"""What to train, as data: hyperparameters, presets of algorithms, members. Imports no JAX."""

import dataclasses
import math
import types
from collections.abc import Mapping, Sequence
from typing import Any, Literal


@dataclasses.dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO; the defaults are the paper's IPPO (appendix, hyperparameters of IPPO)."""

    critic: Literal["local", "central"] = "local"  # what critics see: the role's observation, or the global one
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
    std: Literal["parameter", "state"] = "parameter"  # log standard deviation: one vector, or a head on the torso
    normalise: bool = True  # whether observations are normalised by running statistics

    def __post_init__(self) -> None:
        if isinstance(self.hidden, list):
            object.__setattr__(self, "hidden", tuple(self.hidden))
        widths = isinstance(self.hidden, tuple) and all(isinstance(width, int) and width > 0 for width in self.hidden)
        _check(widths and len(self.hidden) > 0, self, "hidden", "a tuple of widths, such as (128, 128)")
        _check_choices(self, critic=("local", "central"), torso=("mlp", "gru"), activation=("tanh", "relu"))
        _check_choices(self, squash=("clip", "tanh"), std=("parameter", "state"))
        for name in ("num_envs", "rollout_steps", "epochs", "minibatches"):
            _check(isinstance(getattr(self, name), int) and getattr(self, name) >= 1, self, name, "an integer above 0")
        for name in ("learning_rate", "adam_eps", "max_grad_norm", "clip_eps"):
            _check(_positive(getattr(self, name)), self, name, "a positive number")
        for name in ("entropy_coef", "value_coef"):
            _check(getattr(self, name) == 0 or _positive(getattr(self, name)), self, name, "0 or a positive number")
        for name in ("gamma", "gae_lambda"):
            _check(_number(getattr(self, name)) and 0 <= getattr(self, name) <= 1, self, name, "a number in [0, 1]")
        for name in ("anneal_lr", "normalise"):
            _check(isinstance(getattr(self, name), bool), self, name, "true or false")
        if self.num_envs % self.minibatches:
            raise ValueError(
                f"num_envs is {self.num_envs} and minibatches {self.minibatches}; "
                "a minibatch holds whole simulations, so choose num_envs as a multiple of minibatches"
            )

    @property
    def batch_steps(self) -> int:
        """Environment steps of one member in one update."""
        return self.num_envs * self.rollout_steps


# Hyperparameters that are traced, so that members of one program may differ in them.
TRACED = ("learning_rate", "clip_eps", "entropy_coef", "value_coef", "gamma", "gae_lambda", "max_grad_norm")

# The paper's tables, as differences from PPOConfig's defaults. Their "scale clip eps" and "ratio clip eps" are off in
# both: the clip range is neither divided by the number of agents nor made symmetric in the logarithm of the ratio.
PRESETS: Mapping[str, Mapping[str, Any]] = types.MappingProxyType(
    {
        "ippo": {},
        "mappo": {
            "critic": "central",
            "rollout_steps": 128,
            "learning_rate": 4.4e-3,
            "entropy_coef": 2.7e-4,
            "clip_eps": 0.11,
        },
    }
)


def preset(algorithm: str, **changes: Any) -> PPOConfig:
    """Return the hyperparameters of an algorithm, with changes.

    Raises:
        ValueError: If the algorithm or a changed field is unknown, or a value is not allowed.
    """
    if algorithm not in PRESETS:
        raise ValueError(f"algorithm is {algorithm!r}; allowed are {', '.join(PRESETS)}")
    fields = [field.name for field in dataclasses.fields(PPOConfig)]
    if unknown := sorted(set(changes) - set(fields)):
        raise ValueError(f"unknown hyperparameter {', '.join(unknown)}; allowed are {', '.join(fields)}")
    return PPOConfig(**{**PRESETS[algorithm], **changes})


@dataclasses.dataclass(frozen=True)
class Member:
    """One team in training: a robot and a human that learn together."""

    seed: int  # draws its networks, its resets and its actions
    disability: str  # the human's setting, "d1".."d9"
    overrides: Mapping[str, float] = dataclasses.field(default_factory=dict)  # its own values of traced hyperparameters

    def __post_init__(self) -> None:
        _check(isinstance(self.seed, int) and 0 <= self.seed < 2**31, self, "seed", "an integer from 0 to 2^31 - 1")
        if unknown := sorted(set(self.overrides) - set(TRACED)):
            raise ValueError(f"a member overrides {', '.join(unknown)}; members may differ in {', '.join(TRACED)}")

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
    ppo: PPOConfig = dataclasses.field(default_factory=PPOConfig)  # hyperparameters
    checkpoint_every: int = 20  # updates between checkpoints
    updates_per_call: int = 1  # updates dispatched to the device at once
    self_play_episodes: int = 16  # episodes of each team's final evaluation; 0 leaves it out

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        for name in ("steps", "checkpoint_every", "updates_per_call"):
            _check(isinstance(getattr(self, name), int) and getattr(self, name) >= 1, self, name, "an integer above 0")
        _check(self.self_play_episodes >= 0, self, "self_play_episodes", "0 or more")
        if not self.members:
            raise ValueError("a run has no members; give at least one seed and one disability setting")
        distinct = {(member.label, *sorted(member.overrides.items())) for member in self.members}
        if len(distinct) < len(self.members):
            raise ValueError("two members of a run are identical; each (seed, disability, overrides) may appear once")

    @property
    def updates(self) -> int:
        """Number of updates of the run."""
        return math.ceil(self.steps / self.ppo.batch_steps)

    def to_json(self) -> dict[str, Any]:
        """Return JSON-ready values; `TrainConfig.from_json` gives the config back."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "TrainConfig":
        """Return the config that `to_json` described."""
        fields: dict[str, Any] = dict(data)
        fields["members"] = tuple(Member(**member) for member in fields["members"])
        fields["ppo"] = PPOConfig(**fields["ppo"])
        return cls(**fields)


def make_members(seeds: Sequence[int], disabilities: Sequence[str]) -> tuple[Member, ...]:
    """Return every seed with every disability setting, setting by setting."""
    return tuple(Member(seed, disability) for disability in disabilities for seed in seeds)


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
            raise ValueError(f"{name} is {getattr(config, name)!r}; allowed are {', '.join(allowed)}")
