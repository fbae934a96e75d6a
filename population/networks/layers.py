"""A policy's layers as named matrices, from which the exporters write."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from population.networks.spec import PolicySpec

Array = np.ndarray


@dataclasses.dataclass(frozen=True)
class Dense:
    """Dense layer: `x @ kernel + bias`."""

    kernel: Array  # [I, O] float32
    bias: Array  # [O]


@dataclasses.dataclass(frozen=True)
class GRU:
    """Gated recurrent unit with gates in the order reset, update, new.

    `r`, `z` = sigmoid(input + recurrent), `n` = tanh(input + r * recurrent).

    The next carry, and output, is `(1 - z) * n + z * carry`.
    """

    input: Dense  # [I, 3H], [3H]
    recurrent: Dense  # [H, 3H], [3H]; only the last third of the bias is not zero


@dataclasses.dataclass(frozen=True)
class Layers:
    """Parts of a policy's deterministic action, in the order in which they apply."""

    spec: PolicySpec
    normaliser: tuple[Array, Array] | None  # mean [O], std [O]
    hidden: tuple[Dense, ...]  # each followed by the spec's activation
    gru: GRU | None
    mean: Dense
    # A head on the torso, or one vector [A]; not part of the deterministic action.
    log_std: Dense | Array
    # For a policy with a latent: a GRU of observation and last action, and the latent's layer.
    memory: tuple[GRU, Dense] | None = None


def layers_of(spec: PolicySpec, params: Mapping[str, Any]) -> Layers:
    """Return the layers of `Policy(spec)` with parameters that are nested, without a stacked axis.

    Raises:
        ValueError: A parameter is missing.
    """
    embeddings = len(spec.hidden) - (spec.torso == "gru")
    try:
        return Layers(
            spec=spec,
            normaliser=(_f32(params["normaliser"]["mean"]), _f32(params["normaliser"]["std"]))
            if spec.normalise
            else None,
            hidden=tuple(_dense(params[f"Dense_{index}"]) for index in range(embeddings)),
            gru=_gru(params["GRUCell_0"]) if spec.torso == "gru" else None,
            mean=_dense(params[f"Dense_{embeddings}"]),
            log_std=_dense(params[f"Dense_{embeddings + 1}"])
            if spec.std == "state"
            else _f32(params["log_std"]),
            memory=_memory(params["memory"]) if spec.latent else None,
        )
    except KeyError as error:
        raise ValueError(
            f"parameters lack {error}, which a {spec.torso} policy of spec {spec.digest} has"
        ) from None


def _memory(params: Mapping[str, Any]) -> tuple[GRU, Dense]:
    return _gru(params["GRUCell_0"]), _dense(params["Dense_0"])


def _gru(params: Mapping[str, Any]) -> GRU:
    inputs = [_dense(params[name]) for name in ("ir", "iz", "in")]
    recurrent = [_f32(params[name]["kernel"]) for name in ("hr", "hz", "hn")]
    zero = np.zeros(recurrent[0].shape[1], np.float32)
    return GRU(
        Dense(
            np.concatenate([gate.kernel for gate in inputs], 1),
            np.concatenate([gate.bias for gate in inputs]),
        ),
        Dense(
            np.concatenate(recurrent, 1), np.concatenate([zero, zero, _f32(params["hn"]["bias"])])
        ),
    )


def _dense(params: Mapping[str, Any]) -> Dense:
    return Dense(_f32(params["kernel"]), _f32(params["bias"]))


def _f32(value: Any) -> Array:
    return np.asarray(value, np.float32)
