"""Presets of the methods that a robot's training with partners adds to PPO. Imports no JAX."""

from collections.abc import Mapping
from typing import Any

from assistax_base import extensions

# Methods that a robot's training with partners adds to PPO: the place of the class ("" if there is
# none), and the hyperparameters that differ from PPO's. `population.methods.method.register` adds
# a row; `methods` has those of installed packages too.
METHODS: dict[str, tuple[str | type, Mapping[str, Any]]] = {
    "gru": ("", {"torso": "gru"}),
    "asymmetric": ("population.methods.asymmetric:Asymmetric", {"critic": "central"}),
    "asymmetric_gru": (
        "population.methods.asymmetric:Asymmetric",
        {"critic": "central", "torso": "gru"},
    ),
    "liam": ("population.methods.modelling:Modelling", {"latent": 16}),
    "palm": ("population.methods.modelling:Modelling", {"latent": 16, "kl_coef": 1e-2}),
    "osi": (
        "population.methods.modelling:Identification",
        {"critic": "central", "latent": 16},
    ),
    "rl2": ("", {"torso": "gru", "series": 5}),
    "rma": ("population.methods.teacher:Teacher", {"latent": 8, "student_share": 0.4}),
}


def methods() -> tuple[str, ...]:
    """Return the names of all methods: those of `METHODS`, then those of installed packages.

    Raises:
        assistax_base.extensions.ExtensionError: A package takes a name that there is already.
    """
    return (*METHODS, *extensions.extensions(extensions.METHODS, METHODS))
