"""Networks: policies, from observations to a Gaussian over actions, and critics, to values."""

import dataclasses
import math
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jaxtyping import Array, Bool, Float

from population.networks.seat import Carry, Params

if TYPE_CHECKING:
    from population.networks.spec import PolicySpec

NORMALISED_LIMIT = 10.0  # normalised observations are clipped to this many standard deviations
HIDDEN_SCALE = math.sqrt(2.0)  # orthogonal gain of hidden layers
# A standard deviation of 0.6: nine of ten draws of an untrained policy lie within the limits. It is
# a constant of published networks; a run starts from `initial_log_std` of its trainer.
INITIAL_LOG_STD = -0.5
LOG_STD_RANGE = (-5.0, 1.0)
MEAN_SCALE = 0.01  # orthogonal gain of the head: an untrained policy acts around zero

_MEMORY = 1  # folded into a policy's key for the key of its memory
_NODES, _WEIGHTS = (x.astype(np.float32) for x in np.polynomial.hermite_e.hermegauss(9))


@partial(jax.tree_util.register_dataclass, data_fields=["mean", "log_std"], meta_fields=["squash"])
@dataclasses.dataclass(frozen=True)
class Gaussian:
    """Diagonal Gaussian over raw actions [..., A], which `action` maps to [-1, 1].

    With "clip" the limits belong to the environment, and densities are those of the raw action.
    With "tanh" densities are those of the squashed action.
    """

    mean: jax.Array  # [..., A]
    log_std: jax.Array  # [..., A]
    squash: str = "clip"

    def sample(self, key: jax.Array) -> jax.Array:
        """Draw a raw action [..., A]."""
        return self.mean + jnp.exp(self.log_std) * jax.random.normal(key, self.mean.shape)

    def action(self, raw: Float[Array, "*batch A"]) -> Float[Array, "*batch A"]:
        """Return the action in [-1, 1] for a raw action."""
        return jnp.tanh(raw) if self.squash == "tanh" else jnp.clip(raw, -1.0, 1.0)

    def mode(self) -> jax.Array:
        """Return the deterministic action in [-1, 1]."""
        return self.action(self.mean)

    def log_prob(self, raw: Float[Array, "*batch A"]) -> Float[Array, "*batch"]:
        """Return the log density [...] of a raw action [..., A].

        With "tanh" it is the density of the squashed action.
        """
        score = (raw - self.mean) * jnp.exp(-self.log_std)
        density = -0.5 * (jnp.square(score) + math.log(2.0 * math.pi)) - self.log_std
        if self.squash == "tanh":
            density = density - _log_slope(raw)
        return density.sum(-1)

    def entropy(self) -> jax.Array:
        """Return the entropy [...]; Gauss-Hermite quadrature integrates the slope of "tanh"."""
        entropy = self.log_std + 0.5 * (1.0 + math.log(2.0 * math.pi))
        if self.squash == "tanh":
            std = jnp.exp(self.log_std)
            slopes = [
                float(w) * _log_slope(self.mean + std * float(x))
                for x, w in zip(_NODES, _WEIGHTS, strict=True)
            ]
            entropy = entropy + sum(slopes) / math.sqrt(2.0 * math.pi)
        return entropy.sum(-1)


@dataclasses.dataclass(frozen=True)
class CriticSpec:
    """Shape of a critic network."""

    observation_size: int  # width of its input
    torso: str = "mlp"  # "mlp" or "gru"
    hidden: tuple[int, ...] = (128, 128)  # widths of the hidden layers
    activation: str = "tanh"  # after each dense hidden layer


class HiddenLayers(Protocol):
    """Hidden layers of a network: the fields that the specs of policies and critics share."""

    @property
    def torso(self) -> str:
        """Kind of the layers: "mlp" or "gru"."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the layers."""

    @property
    def activation(self) -> str:
        """Activation after each dense layer: "tanh" or "relu"."""


class _Network:
    """Base of networks on plain nested parameters, whose leading axes are free."""

    spec: Any

    def initial_carry(self, batch_shape: tuple[int, ...]) -> Carry:
        """Return the recurrent state before the first observation.

        () for a feed-forward network, [*batch_shape, H] for a recurrent torso.
        """
        return jnp.zeros((*batch_shape, self.spec.hidden[-1])) if self.spec.torso == "gru" else ()

    def step(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, Any]:
        """Return the new carry and the output for obs [..., O]; see the subclasses."""
        raise NotImplementedError


class Critic(_Network):
    """The network of a `CriticSpec`; its input is normalised by the caller."""

    def __init__(self, spec: CriticSpec) -> None:
        self.spec = spec
        self._module = _Value(spec)

    def init(self, key: jax.Array) -> Params:
        """Return fresh parameters."""
        obs = jnp.zeros(self.spec.observation_size)
        return self._module.init(key, self.initial_carry(()), obs, jnp.zeros((), bool))["params"]

    def inputs(self, params: Params, obs: jax.Array) -> jax.Array:
        """Return the input of the first layer for obs [..., O]: here obs itself."""
        return obs

    def step(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, jax.Array]:
        """Return the new carry and the values [...] of obs [..., O]."""
        output: Any = self._module.apply({"params": params}, carry, obs, first)
        return output


class Policy(_Network):
    """The network of a `PolicySpec`."""

    # Observations appended to the role's own, in training alone.
    beside: tuple[str, ...] = ()

    def __init__(self, spec: "PolicySpec") -> None:
        self.spec = spec
        self._module = _Actor(spec)
        self._memory = _Memory(spec)

    def initial_carry(self, batch_shape: tuple[int, ...]) -> Carry:
        """Return the recurrent state before the first observation.

        For a policy with a latent it is the memory's state and last action, [*batch_shape, H + A].
        """
        if not self.spec.latent:
            return super().initial_carry(batch_shape)
        return jnp.zeros((*batch_shape, self.spec.hidden[-1] + self.spec.action_size))

    def init(self, key: jax.Array, log_std: float = INITIAL_LOG_STD) -> Params:
        """Return initial parameters; with `spec.normalise` they hold an identity "normaliser".

        Args:
            key: Key of the draws.
            log_std: Logarithm of the standard deviation at the start.
        """
        size, latent = self.spec.observation_size, self.spec.latent
        carry, seen = self.initial_carry(()), jnp.zeros(size + latent)
        params = self._module.init(key, carry, seen, jnp.zeros((), bool))["params"]
        params = _with_log_std(params, log_std)
        if latent:
            seen = jnp.zeros(size + self.spec.action_size)
            hidden = jnp.zeros(self.spec.hidden[-1])
            memory = self._memory.init(jax.random.fold_in(key, _MEMORY), hidden, seen)["params"]
            params = {**params, "memory": memory}
        if self.spec.normalise:
            params = {**params, "normaliser": {"mean": jnp.zeros(size), "std": jnp.ones(size)}}
        return params

    def step(
        self,
        params: Params,
        carry: Carry,
        obs: Float[Array, "*batch O"],
        first: Bool[Array, "*batch"],
    ) -> tuple[Carry, Gaussian]:
        """Return the new carry and the distribution over actions.

        Args:
            params: Parameters of one policy.
            carry: Recurrent state; it is set to zero where `first`.
            obs: Observations [..., O].
            first: Whether an observation starts an episode [...].
        """
        if self.spec.latent:
            hidden, latent = self.recall(params, carry, obs, first)
            gaussian = self.given(params, obs, latent)
            return self.acted(hidden, gaussian.mode()), gaussian
        if self.spec.normalise:
            obs = normalise(params["normaliser"], obs)
        output: Any = self._module.apply({"params": _layers(params)}, carry, obs, first)
        carry, (mean, log_std) = output
        return carry, Gaussian(mean, log_std, self.spec.squash)

    def recall(
        self,
        params: Params,
        carry: Carry,
        obs: Float[Array, "*batch O"],
        first: Bool[Array, "*batch"],
    ) -> tuple[Carry, Float[Array, "*batch Z"]]:
        """Return the memory's new state and the latent after obs [..., O]."""
        if self.spec.normalise:
            obs = normalise(params["normaliser"], obs)
        carry = jnp.where(first[..., None], 0.0, carry)
        hidden, last = jnp.split(carry, (self.spec.hidden[-1],), axis=-1)
        seen = jnp.concatenate([obs, last], axis=-1)
        output: Any = self._memory.apply({"params": params["memory"]}, hidden, seen)
        return output

    def given(
        self, params: Params, obs: Float[Array, "*batch O"], latent: Float[Array, "*batch Z"]
    ) -> Gaussian:
        """Return the distribution over actions for obs [..., O] and a latent [..., Z]."""
        if self.spec.normalise:
            obs = normalise(params["normaliser"], obs)
        seen, first = jnp.concatenate([obs, latent], axis=-1), jnp.zeros(obs.shape[:-1], bool)
        output: Any = self._module.apply({"params": _layers(params)}, (), seen, first)
        _, (mean, log_std) = output
        return Gaussian(mean, log_std, self.spec.squash)

    def acted(self, carry: Carry, action: Float[Array, "*batch A"]) -> Carry:
        """Return the carry after an action was drawn; the memory of a latent stores the action."""
        if not self.spec.latent:
            return carry
        return jnp.concatenate([carry[..., : self.spec.hidden[-1]], action], axis=-1)

    def act(
        self,
        params: Params,
        carry: Carry,
        obs: Float[Array, "*batch O"],
        first: Bool[Array, "*batch"],
    ) -> tuple[Carry, Float[Array, "*batch A"]]:
        """Return the new carry and the most likely action [..., A], in [-1, 1]."""
        carry, distribution = self.step(params, carry, obs, first)
        return carry, distribution.mode()


def normalise(normaliser: Params, obs: Float[Array, "*batch O"]) -> Float[Array, "*batch O"]:
    """Return obs [..., O] centred and scaled by mean [O] and std [O], clipped to a fixed limit."""
    mean, std = (jnp.broadcast_to(normaliser[name], obs.shape) for name in ("mean", "std"))
    return jnp.clip((obs - mean) / std, -NORMALISED_LIMIT, NORMALISED_LIMIT)


class _Actor(nn.Module):
    """Layers of a policy: carry, mean and log standard deviation of the actions."""

    spec: "PolicySpec"

    @nn.compact
    def __call__(
        self, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, tuple[jax.Array, jax.Array]]:
        size = self.spec.action_size
        carry, features = _torso(self.spec, carry, obs, first)
        mean = _dense(size, MEAN_SCALE)(features)
        if self.spec.std == "state":
            log_std = INITIAL_LOG_STD + _dense(size, MEAN_SCALE)(features)
        else:
            log_std = self.param("log_std", nn.initializers.constant(INITIAL_LOG_STD), (size,))
        return carry, (mean, jnp.broadcast_to(jnp.clip(log_std, *LOG_STD_RANGE), mean.shape))


class _Memory(nn.Module):
    """Memory cell: the state and the latent, from an observation and the action before it."""

    spec: "PolicySpec"

    @nn.compact
    def __call__(self, hidden: jax.Array, seen: jax.Array) -> tuple[jax.Array, jax.Array]:
        hidden, features = nn.GRUCell(self.spec.hidden[-1])(hidden, seen)
        return hidden, _dense(self.spec.latent, 1.0)(features)


class _Value(nn.Module):
    """Layers of a critic: carry and values."""

    spec: CriticSpec

    @nn.compact
    def __call__(self, carry: Carry, obs: jax.Array, first: jax.Array) -> tuple[Carry, jax.Array]:
        carry, features = _torso(self.spec, carry, obs, first)
        return carry, _dense(1, 1.0)(features)[..., 0]


def _torso(
    spec: HiddenLayers, carry: Carry, obs: jax.Array, first: jax.Array
) -> tuple[Carry, jax.Array]:
    """Return the carry and the features after the hidden layers.

    Call it inside a compact module, which then owns the layers by flat names.
    """
    activation = {"tanh": nn.tanh, "relu": nn.relu}[spec.activation]
    features = obs
    for width in spec.hidden[:-1] if spec.torso == "gru" else spec.hidden:
        features = activation(_dense(width, HIDDEN_SCALE)(features))
    if spec.torso == "gru":
        carry = jnp.where(first[..., None], 0.0, carry)
        carry, features = nn.GRUCell(spec.hidden[-1])(carry, features)
    return carry, features


def _dense(width: int, scale: float) -> nn.Dense:
    """Return a dense layer with orthogonal weights of the given gain and zero bias."""
    return nn.Dense(width, kernel_init=nn.initializers.orthogonal(scale))


def _layers(params: Params) -> Params:
    """Return the parameters of a policy's layers, without those of normaliser and memory."""
    return {name: params[name] for name in params if name not in ("normaliser", "memory")}


def _with_log_std(params: Params, log_std: float) -> Params:
    """Return initial parameters with another log standard deviation.

    The network adds `INITIAL_LOG_STD` to its state-dependent head, so the head's bias takes the
    difference. A vector is replaced.
    """
    if "log_std" in params:
        return {**params, "log_std": jnp.full_like(params["log_std"], log_std)}
    head = max((name for name in params if name.startswith("Dense_")), key=lambda n: int(n[6:]))
    bias = params[head]["bias"] + (log_std - INITIAL_LOG_STD)
    return {**params, head: {**params[head], "bias": bias}}


def _log_slope(raw: jax.Array) -> jax.Array:
    """Return log(1 - tanh(raw)^2) without loss of precision in the tails."""
    return 2.0 * (math.log(2.0) - raw - jax.nn.softplus(-2.0 * raw))
