"""Export of a policy as a PyTorch state dict in safetensors, without torch.

docs/export.md has the module that loads it.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from assistax_base.files import METADATA_KEY
from population.networks.layers import Dense, layers_of
from population.networks.spec import PolicySpec


def to_torch(
    spec: PolicySpec, params: Mapping[str, Any], metadata: Mapping[str, Any] | None = None
) -> bytes:
    """Return safetensors bytes of a state dict with PyTorch's names and layout: weights [out, in].

    The names are `layers.I.weight`, `layers.I.bias`, `mean.weight`, `mean.bias`, and `log_std`, or
    `log_std.weight` and `log_std.bias`. With normalisation there are `obs_mean` and `obs_std`. A
    recurrent policy has `gru.weight_ih`, `gru.weight_hh`, `gru.bias_ih`, `gru.bias_hh` as
    `torch.nn.GRUCell` does. The metadata's one key, "assistax", holds JSON with the spec.

    Raises:
        ValueError: A parameter is missing, or the policy has a latent.
    """
    import safetensors.numpy

    if spec.latent:
        raise ValueError(
            f"the policy reads a latent of {spec.latent} numbers, for which the format torch has "
            "no module: export it as onnx"
        )
    layers = layers_of(spec, params)
    state: dict[str, np.ndarray] = {}
    for index, layer in enumerate(layers.hidden):
        state |= _linear(f"layers.{index}", layer)
    if layers.gru is not None:
        for part, layer in (("ih", layers.gru.input), ("hh", layers.gru.recurrent)):
            state |= {f"gru.weight_{part}": layer.kernel.T, f"gru.bias_{part}": layer.bias}
    state |= _linear("mean", layers.mean)
    state |= (
        _linear("log_std", layers.log_std)
        if isinstance(layers.log_std, Dense)
        else {"log_std": layers.log_std}
    )
    if layers.normaliser is not None:
        state |= dict(zip(("obs_mean", "obs_std"), layers.normaliser, strict=True))
    text = json.dumps({"spec": spec.to_json(), **(metadata or {})}, sort_keys=True, allow_nan=False)
    return safetensors.numpy.save(
        {name: np.ascontiguousarray(value) for name, value in state.items()}, {METADATA_KEY: text}
    )


def _linear(name: str, layer: Dense) -> dict[str, np.ndarray]:
    return {f"{name}.weight": layer.kernel.T, f"{name}.bias": layer.bias}
