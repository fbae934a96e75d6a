"""Export of a policy as an ONNX graph of standard operators, to its deterministic action."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from assistax_base.extras import optional
from assistax_base.files import METADATA_KEY
from population.networks.layers import GRU, Dense, Layers, layers_of
from population.networks.policy import NORMALISED_LIMIT
from population.networks.spec import PolicySpec

OPSET = 17
IR_VERSION = 8  # read by every runtime since 2022


def to_onnx(
    spec: PolicySpec, params: Mapping[str, Any], metadata: Mapping[str, Any] | None = None
) -> bytes:
    """Return the bytes of an ONNX model of the policy's deterministic action.

    The input is `obs` [N, O] float32. A recurrent policy also has `carry` [N, H] float32 and
    `first` [N] bool, which is true if an observation starts an episode. The output is `action`
    [N, A] in [-1, 1]. A recurrent policy also has `next_carry` [N, H]. The carry of a policy with a
    latent has A more numbers, its last action.

    Args:
        spec: The network.
        params: Its parameters, without a stacked axis.
        metadata: JSON values for the model's property "assistax", beside the spec.

    Raises:
        ValueError: The `onnx` package is not installed, or a parameter is missing.
    """
    onnx = optional("onnx", "the format onnx", "export")
    graph = _Graph(onnx.helper, onnx.numpy_helper)
    layers = layers_of(spec, params)
    inputs, outputs = _write(graph, layers)
    float_type, helper = onnx.TensorProto.FLOAT, onnx.helper

    def value(name: str) -> Any:
        memory = spec.hidden[-1] + (spec.action_size if spec.latent else 0)
        width = {"obs": spec.observation_size, "action": spec.action_size}.get(name, memory)
        if name == "first":
            return helper.make_tensor_value_info(name, onnx.TensorProto.BOOL, ["N"])
        return helper.make_tensor_value_info(name, float_type, ["N", width])

    body = helper.make_graph(
        graph.nodes,
        "policy",
        [value(n) for n in inputs],
        [value(n) for n in outputs],
        graph.weights,
    )
    model = helper.make_model(
        body,
        opset_imports=[helper.make_opsetid("", OPSET)],
        producer_name="assistax-zoo",
        ir_version=IR_VERSION,
    )
    text = json.dumps({"spec": spec.to_json(), **(metadata or {})}, sort_keys=True, allow_nan=False)
    helper.set_model_props(model, {METADATA_KEY: text})
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


def _write(graph: "_Graph", layers: Layers) -> tuple[list[str], list[str]]:
    """Add the policy's nodes; return the names of the model's inputs and of its outputs."""
    features, inputs, outputs = "obs", ["obs"], ["action"]
    if layers.normaliser is not None:
        mean, std = (graph.constant(value) for value in layers.normaliser)
        features = graph.clip(
            graph.add("Div", graph.add("Sub", features, mean), std), NORMALISED_LIMIT
        )
    hidden = ""
    if layers.memory is not None:
        inputs, outputs = ["obs", "carry", "first"], ["action", "next_carry"]
        features, hidden = _recall(graph, layers, features)
    for layer in layers.hidden:
        features = graph.add(
            {"tanh": "Tanh", "relu": "Relu"}[layers.spec.activation], graph.dense(features, layer)
        )
    if layers.gru is not None:
        inputs, outputs = ["obs", "carry", "first"], ["action", "next_carry"]
        carry = graph.remembered("carry")
        features = _gru(graph, layers.gru, features, carry, output="next_carry")
    mean = graph.dense(features, layers.mean)
    if layers.spec.squash == "tanh":
        graph.add("Tanh", mean, output="action")
    else:
        graph.clip(mean, 1.0, output="action")
    if hidden:
        graph.join(hidden, "action", output="next_carry")
    return inputs, outputs


def _recall(graph: "_Graph", layers: Layers, obs: str) -> tuple[str, str]:
    """Add the memory of a policy with a latent; return its output's and its state's name."""
    assert layers.memory is not None
    gru, latent = layers.memory
    sizes = graph.sizes([gru.recurrent.kernel.shape[0], layers.spec.action_size])
    before, last = graph.split(graph.remembered("carry"), sizes)
    hidden = _gru(graph, gru, graph.join(obs, last), before)
    return graph.join(obs, graph.dense(hidden, latent)), hidden


def _gru(graph: "_Graph", gru: GRU, features: str, carry: str, output: str | None = None) -> str:
    """Add a GRU cell gate by gate, since ONNX's GRU needs a time axis; return the output's name."""
    thirds = graph.sizes([gru.recurrent.kernel.shape[0]] * 3)
    x = graph.split(graph.dense(features, gru.input), thirds)
    h = graph.split(graph.dense(carry, gru.recurrent), thirds)
    reset, update = (graph.add("Sigmoid", graph.add("Add", x[gate], h[gate])) for gate in range(2))
    new = graph.add("Tanh", graph.add("Add", x[2], graph.add("Mul", reset, h[2])))
    old_share = graph.add("Mul", update, carry)
    new_share = graph.add("Mul", graph.add("Sub", graph.constant(np.float32(1.0)), update), new)
    return graph.add("Add", new_share, old_share, output=output)


class _Graph:
    """Nodes and weights of a graph, in the order in which they are added; each node has a name."""

    def __init__(self, helper: Any, numpy_helper: Any) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []
        self._helper, self._numpy_helper = helper, numpy_helper

    def add(self, operator: str, *inputs: str, output: str | None = None) -> str:
        output = output or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(self._helper.make_node(operator, list(inputs), [output], name=output))
        return output

    def sizes(self, sizes: Sequence[int]) -> tuple[str, int]:
        return self.constant(np.asarray(sizes, np.int64)), len(sizes)

    def split(self, value: str, sizes: tuple[str, int]) -> list[str]:
        outputs = [f"split_{len(self.nodes)}_{part}" for part in range(sizes[1])]
        self.nodes.append(
            self._helper.make_node("Split", [value, sizes[0]], outputs, name=outputs[0], axis=1)
        )
        return outputs

    def join(self, *values: str, output: str | None = None) -> str:
        output = output or f"concat_{len(self.nodes)}"
        node = self._helper.make_node("Concat", list(values), [output], name=output, axis=1)
        self.nodes.append(node)
        return output

    def remembered(self, carry: str) -> str:
        """Add a carry that is reset where an episode begins; return its name."""
        first = self.add("Unsqueeze", "first", self.constant(np.array([1], np.int64)))
        return self.add("Where", first, self.constant(np.float32(0.0)), carry)

    def constant(self, value: Any) -> str:
        name = f"weight_{len(self.weights)}"
        self.weights.append(self._numpy_helper.from_array(np.asarray(value), name))
        return name

    def dense(self, value: str, layer: Dense) -> str:
        return self.add("Gemm", value, self.constant(layer.kernel), self.constant(layer.bias))

    def clip(self, value: str, limit: float, output: str | None = None) -> str:
        ends = (self.constant(np.float32(-limit)), self.constant(np.float32(limit)))
        return self.add("Clip", value, *ends, output=output)
