"""Shared parameters: one network for both roles.

The network reads a padded observation and the role's one-hot. Neither need ever be built: the
padded rows of the first kernel do nothing, and the one-hot adds one of its rows to the bias. `fold`
makes an ordinary network of one role that way, exactly; training, acting and publishing all use it.
"""

import dataclasses
from collections.abc import Mapping, Sequence

from population.networks.seat import Params
from population.networks.spec import ROLES, PolicySpec

SHARED = "shared"  # name of the learner of both roles


def padded_size(observation_size: Mapping[str, int]) -> int:
    """Return the width of the shared input: the widest observation of a role, plus the one-hot."""
    return max(observation_size.values()) + len(ROLES)


def shared_spec(specs: Sequence[PolicySpec]) -> PolicySpec:
    """Return the spec of the network that acts for the roles of these specs."""
    width = padded_size({spec.role: spec.observation_size for spec in specs})
    actions = max(spec.action_size for spec in specs)
    return dataclasses.replace(specs[0], observation_size=width, action_size=actions)


def fold(
    params: Params, role: str, observation_size: int, action_size: int | None = None
) -> Params:
    """Return the ordinary parameters of one role, made of a shared network's.

    With W the first kernel and e the role's one-hot, [obs, 0, e] W + b = obs W[:O] + (W[-2 + role]
    + b). Outputs beyond the role's actions are dropped.

    Args:
        params: Parameters of the shared network, whose first layer is Dense_0 and whose last are
            its heads; leading axes are free.
        role: The role.
        observation_size: Width O of the role's input.
        action_size: Width of the role's action; None for a critic, whose output is one value.
    """
    kernel, bias = params["Dense_0"]["kernel"], params["Dense_0"]["bias"]
    one_hot = kernel[..., ROLES.index(role) - len(ROLES), :]
    folded = {
        **params,
        "Dense_0": {"kernel": kernel[..., :observation_size, :], "bias": bias + one_hot},
    }
    if action_size is None:
        return folded
    for name in _heads(params):
        folded[name] = {leaf: value[..., :action_size] for leaf, value in params[name].items()}
    if "log_std" in params:
        folded["log_std"] = params["log_std"][..., :action_size]
    return folded


def _heads(params: Params) -> list[str]:
    """Return the names of the output layers.

    They are the last dense layer, or the last two with a state-dependent deviation.
    """
    dense = sorted(
        (name for name in params if name.startswith("Dense_")), key=lambda name: int(name[6:])
    )
    return dense[-1:] if "log_std" in params else dense[-2:]
