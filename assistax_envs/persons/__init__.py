"""Persons: partners made of numbers, whose reactions robots can see. See `docs/persons.md`."""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from assistax_envs.persons.player import PersonPlayer, draw_persons, person_params
    from assistax_envs.persons.rows import (
        COUNT,
        PARAMETERS,
        Parameter,
        Person,
        card,
        numbers,
        person,
        persons,
    )

# Loaded on first use: rows need neither JAX nor MuJoCo.
_HOMES = {
    "COUNT": "rows",
    "PARAMETERS": "rows",
    "Parameter": "rows",
    "Person": "rows",
    "PersonPlayer": "player",
    "card": "rows",
    "draw_persons": "player",
    "numbers": "rows",
    "person": "rows",
    "person_params": "player",
    "persons": "rows",
}

__all__ = [
    "COUNT",
    "PARAMETERS",
    "Parameter",
    "Person",
    "PersonPlayer",
    "card",
    "draw_persons",
    "numbers",
    "person",
    "person_params",
    "persons",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
