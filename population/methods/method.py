"""Base class of the methods that extend PPO, and their registration.

A method is chosen by the hyperparameter `method`. It may give the learner further networks, each
with an optimiser and a gradient clip of its own, and a loss that is added to PPO's:
L = L_PPO + aux_coef L_method. It learns from the rollout. Only the robot's acting network is
written.
"""

import importlib
import types
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from population.environment import Environment
from population.hyperparameters import PPOConfig, find_method
from population.method_presets import METHODS, methods
from population.methods.ppo_loss import Hyper, Metrics, Samples
from population.networks.policy import Critic, CriticSpec, Policy
from population.networks.seat import Carry, Params
from population.networks.spec import PolicySpec

if TYPE_CHECKING:
    from population.partners.frozen import FrozenPartners


class Method:
    """Method that adds nothing to PPO; subclasses override what they add.

    Args:
        config: Hyperparameters.
        env: The environment, with the observations that the method reads.
        partners: Partners in the other seat.
    """

    # Hyperparameters that differ from PPO's, of a method that an installed package adds.
    preset: Mapping[str, Any] = types.MappingProxyType({})
    # Observations in a rollout beside those of role and critic, see `methods.hidden`.
    sees: tuple[str, ...] = ()
    critic_sees: tuple[str, ...] = ()  # those of `sees` that critics read, not normalised
    watches = False  # whether a rollout records the partner's actions: `Samples.partner`

    def __init__(
        self, config: PPOConfig, env: Environment, partners: "FrozenPartners | None"
    ) -> None:
        self.config, self.env, self.partners = config, env, partners

    def policy(self, spec: PolicySpec) -> Policy:
        """Return the policy that acts in training; the network of its spec is published."""
        return Policy(spec)

    def acting(self, params: Params, networks: Mapping[str, Params], progress: jax.Array) -> Params:
        """Return the parameters that act in a rollout; leaves [M, ...].

        Args:
            params: Parameters of the published network.
            networks: All networks of the learner.
            progress: Share of the run done [].
        """
        return params

    def critic(self, spec: CriticSpec) -> Critic:
        """Return the critic of a spec, whose width covers all of its inputs."""
        return Critic(spec)

    def init(self, policy: Policy, key: jax.Array) -> dict[str, Params]:
        """Return the method's initial networks by name, without "actor" and "critic"."""
        return {}

    def scheduled(self, hyper: Hyper, progress: jax.Array) -> Hyper:
        """Return the hyperparameters [M] for a share of the run done."""
        return hyper

    def rate(self, network: str, hyper: Hyper) -> jax.Array:
        """Return the learning rate of a network."""
        return hyper["learning_rate"]

    def latent(self, networks: Mapping[str, Params], samples: Samples) -> jax.Array:
        """Return the latents [T, N, Z] that the policy reads while PPO learns."""
        return samples.latent

    def loss(
        self,
        networks: Mapping[str, Params],
        policy: Policy,
        params: Params,
        samples: Samples,
        carry: Carry,
    ) -> tuple[jax.Array, Metrics]:
        """Return the method's loss of a minibatch [T, N, ...], and metrics to log.

        Args:
            networks: All networks of the learner.
            policy: The robot's network.
            params: Parameters that the robot acts with.
            samples: Samples of the robot's role.
            carry: Carry of the robot at the start [N, ...].
        """
        return jnp.zeros(()), {}


def method_class(name: str) -> type[Method]:
    """Return the class of a method's name; for "" and methods without a class, `Method`."""
    place: Any = (find_method(name)[0] if name else "") or Method
    if isinstance(place, str):
        module, _, class_name = place.partition(":")
        place = getattr(importlib.import_module(module), class_name)
    return place


def register(name: str, method: type[Method], **hyperparameters: Any) -> None:
    """Register a method in this process, under a name that `train_ego` takes as algorithm.

    Args:
        name: Lower-case letters, digits and underscores, as in ids.
        method: The method's class.
        hyperparameters: Differences of its preset from PPO's.

    Raises:
        ValueError: Another method has the name.
    """
    if name in methods() and METHODS.get(name, (None,))[0] is not method:
        raise ValueError(f"there is a method {name!r} already; choose another name")
    METHODS[name] = method, hyperparameters
