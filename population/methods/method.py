"""What every method may add to PPO, and where a method of one's own is made known.

A method is chosen by the hyperparameter `method`. It may give the learner further networks, each
with an optimiser and a gradient clip of its own, and a loss that is added to PPO's:
L = L_PPO + aux_coef L_method. What it learns from comes with the rollout. Nothing of it is written
but what the robot acts with.
"""

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from population.environment import Environment
from population.hyperparameters import METHODS, PPOConfig
from population.methods.ppo_loss import Hyper, Metrics, Samples
from population.networks.policy import Critic, CriticSpec, Policy
from population.networks.seat import Carry, Params
from population.networks.spec import PolicySpec

if TYPE_CHECKING:
    from population.trainers.frozen_partners import FrozenPartners


class Method:
    """Adds nothing to PPO: what a method does not say is as it is here.

    Args:
        config: Hyperparameters.
        env: The environment, with what the method observes.
        partners: Who sits in the other seat.
    """

    # Observations that come with a rollout beside those of role and critic, see `methods.hidden`.
    sees: tuple[str, ...] = ()
    critic_sees: tuple[str, ...] = ()  # those of them that critics read, as they are
    watches = False  # whether a rollout records what the partner does: `Samples.partner`

    def __init__(
        self, config: PPOConfig, env: Environment, partners: "FrozenPartners | None"
    ) -> None:
        self.config, self.env, self.partners = config, env, partners

    def policy(self, spec: PolicySpec) -> Policy:
        """Return what acts in training for the network of a spec, which is published."""
        return Policy(spec)

    def acting(self, params: Params, networks: Mapping[str, Params], progress: jax.Array) -> Params:
        """Return the parameters of what acts at a share of the run; leaves [M, ...].

        Args:
            params: Those of the network that is published.
            networks: All networks of the learner.
            progress: Share of the run [].
        """
        return params

    def critic(self, spec: CriticSpec) -> Critic:
        """Return the critic; its spec has the width of all that it is given."""
        return Critic(spec)

    def init(self, policy: Policy, key: jax.Array) -> dict[str, Params]:
        """Return the method's networks by name, beside "actor" and "critic"."""
        return {}

    def scheduled(self, hyper: Hyper, progress: jax.Array) -> Hyper:
        """Return the hyperparameters [M] at a share of the run."""
        return hyper

    def rate(self, network: str, hyper: Hyper) -> jax.Array:
        """Return the learning rate of a network."""
        return hyper["learning_rate"]

    def latent(self, networks: Mapping[str, Params], samples: Samples) -> jax.Array:
        """Return the latents [T, N, Z] with which PPO learns."""
        return samples.latent

    def loss(
        self,
        networks: Mapping[str, Params],
        policy: Policy,
        params: Params,
        samples: Samples,
        carry: Carry,
    ) -> tuple[jax.Array, Metrics]:
        """Return the method's own loss of a minibatch [T, N, ...], and what to log.

        Args:
            networks: All networks of the learner.
            policy: The robot's network.
            params: Its parameters, as it acts with them.
            samples: What the robot learns from.
            carry: Of the robot at the start [N, ...].
        """
        return jnp.zeros(()), {}


def method_class(name: str) -> type[Method]:
    """Return the class of a method; that of none adds nothing."""
    home: Any = (METHODS[name][0] if name else "") or Method  # "" is of hyperparameters alone
    if isinstance(home, str):
        module, _, kind = home.partition(":")
        home = getattr(importlib.import_module(module), kind)
    return home


def register(name: str, method: type[Method], **hyperparameters: Any) -> None:
    """Make a method known in this process, under a name that `train_ego` takes as algorithm.

    Args:
        name: As ids have it: lower-case letters, digits and underscores.
        method: What it adds.
        hyperparameters: In which its preset differs from PPO's.

    Raises:
        ValueError: Another method has the name.
    """
    if METHODS.get(name, (method,))[0] is not method:
        raise ValueError(f"there is a method {name!r} already; choose another name")
    METHODS[name] = method, hyperparameters
