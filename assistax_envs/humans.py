"""The human of each simulation as arrays: impairment and preference."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.disability import DISABILITY_SETTINGS, Disability
from assistax_envs.own_settings import own_settings
from assistax_envs.preferences import DRAWN, PREFERENCES


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class EnvParams:
    """The human in each simulation, [N] each: its impairment (see `Disability`), its preference."""

    strength: jax.Array
    elbow_range: jax.Array
    tremor: jax.Array
    # int32: k for pk, 0 if one is drawn anew at each reset. Tasks without preferences ignore it.
    preference_code: jax.Array
    # `gentle_base.Preferences` of persons, whose values are no row of the table; replaces the code.
    preference: Any = None
    # int32: the person's number, kept for callers. Environments ignore it.
    person: Any = None
    # Width of liking in which training begins, see `tasks.care`; None for the tasks' own.
    width: Any = None


@own_settings()
def disability_params(
    settings: Sequence[str | Disability],
    preferences: Sequence[str] | np.ndarray | None = None,
) -> EnvParams:
    """Return the humans [N] of settings given as "d1".."d9" or `Disability`.

    Args:
        settings: [N] of their bodies.
        preferences: [N] "p1".."p9", or "drawn" for one that changes from episode to episode; all
            drawn if not given. [N, K] where each plays several episodes, as in evaluations.
    """
    rows = [_disability(setting) for setting in settings]
    body = {
        field.name: jnp.asarray([getattr(row, field.name) for row in rows], jnp.float32)
        for field in dataclasses.fields(Disability)
    }
    names = np.full(len(rows), DRAWN) if preferences is None else np.asarray(preferences)
    codes = [_preference(str(name)) for name in names.ravel()]
    return EnvParams(**body, preference_code=jnp.asarray(codes, jnp.int32).reshape(names.shape))


def _disability(setting: str | Disability) -> Disability:
    if isinstance(setting, Disability):
        return setting
    if setting not in DISABILITY_SETTINGS:
        raise ValueError(
            f"disability setting is {setting!r}; allowed are {', '.join(DISABILITY_SETTINGS)}"
        )
    return DISABILITY_SETTINGS[setting]


def _preference(name: str) -> int:
    allowed = (DRAWN, *PREFERENCES)
    if name not in allowed:
        raise ValueError(f"preference is {name!r}; allowed are {', '.join(allowed)}")
    return allowed.index(name)
