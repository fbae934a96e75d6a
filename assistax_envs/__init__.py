"""Assistive tasks for a robot and a human on MuJoCo, batch first. Usable on its own."""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from assistax_envs.disability import DISABILITY_SETTINGS, Disability
    from assistax_envs.env import Env, EnvState, make, select
    from assistax_envs.humans import EnvParams, disability_params
    from assistax_envs.versions import TASKS, VERSIONS

# Loaded on first use, so that reading versions and settings needs neither JAX nor MuJoCo.
_HOMES = {
    "DISABILITY_SETTINGS": "disability",
    "Disability": "disability",
    "Env": "env",
    "EnvParams": "humans",
    "EnvState": "env",
    "TASKS": "versions",
    "VERSIONS": "versions",
    "disability_params": "humans",
    "make": "env",
    "select": "env",
}

__all__ = [
    "DISABILITY_SETTINGS",
    "TASKS",
    "VERSIONS",
    "Disability",
    "Env",
    "EnvParams",
    "EnvState",
    "disability_params",
    "make",
    "select",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
