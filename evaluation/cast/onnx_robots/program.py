"""An ONNX graph that `admission` accepted, as a JAX function that is played like a partner.

The graph runs row by row (`jax.vmap` over rows of one observation each), so rows cannot influence
each other. Weights are parameters and may be stacked. The graph is hashable, so robots of one graph
share a compiled program. Semantics: https://onnx.ai/onnx/operators/
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from population.networks.seat import SeatSizes

Attributes = Mapping[str, Any]
Value = Any  # a JAX array, or a tuple of ints: shapes and indices are never computed from data


@dataclasses.dataclass(frozen=True)
class Node:
    """One operator with the names of its inputs ("" for an omitted one) and outputs."""

    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: tuple[tuple[str, Any], ...] = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class OnnxProgram(SeatSizes):
    """A graph without its weights."""

    carry_size: int  # 0 if the robot has no memory
    inputs: tuple[str, ...]  # obs, then carry, then first
    outputs: tuple[str, ...]  # action, then the next carry
    weights: tuple[str, ...]  # names in the graph of parameters "w0", "w1", ...
    constants: tuple[tuple[str, int | tuple[int, ...]], ...]  # integers, by name
    nodes: tuple[Node, ...]

    def player(self) -> "OnnxPolicy":
        """Return the policy that plays this graph."""
        return OnnxPolicy(self)


class OnnxPolicy:
    """Policy that runs a graph."""

    def __init__(self, program: OnnxProgram) -> None:
        self._program = program

    def initial_carry(self, batch_shape: tuple[int, ...]) -> Any:
        """Return the carry before the first observation: zeros [..., H], or ()."""
        size = self._program.carry_size
        return jnp.zeros((*batch_shape, size)) if size else ()

    def act(
        self,
        params: Mapping[str, Any],
        carry: Any,
        obs: Float[Array, "*batch O"],
        first: Bool[Array, "*batch"],
    ) -> tuple[Any, Float[Array, "*batch A"]]:
        """Return the next carry [..., H] and actions [..., A] for observations [..., O]."""
        program = self._program
        inputs = [obs]
        if program.carry_size:
            # A graph without the input `first` cannot reset its memory itself.
            inputs.append(jnp.where(first[..., None], 0.0, carry))
        if len(program.inputs) == 3:
            inputs.append(first)

        def one_row(*row: jax.Array) -> tuple[jax.Array, ...]:
            return tuple(out[0] for out in run(program, params, [value[None] for value in row]))

        mapped = one_row
        for _ in range(first.ndim):
            mapped = jax.vmap(mapped)
        action, *rest = mapped(*inputs)
        return (rest[0] if rest else carry), jnp.clip(action, -1.0, 1.0)


def run(
    program: OnnxProgram,
    params: Mapping[str, Any],
    inputs: list[Any],
    watch: Callable[[Node, list[Value], Value], None] | None = None,
) -> list[Any]:
    """Run a graph once and return its outputs; `watch` is called with node, inputs, each output."""
    values: dict[str, Value] = dict(zip(program.inputs, inputs, strict=True))
    values |= {name: params[f"w{place}"] for place, name in enumerate(program.weights)}
    values |= dict(program.constants)
    for node in program.nodes:
        arguments = [values[name] if name else None for name in node.inputs]
        answer = OPERATORS[node.operator](dict(node.attributes), *arguments)
        outputs = answer if isinstance(answer, list) else [answer]
        if watch is not None:
            for output in outputs:
                watch(node, arguments, output)
        values |= dict(zip(node.outputs, outputs, strict=False))
    return [values[name] for name in program.outputs]


def _simple(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return an operator that ignores attributes and calls `function` on its inputs."""
    return lambda attributes, *inputs: function(*inputs)


def _gemm(attributes: Attributes, a: Any, b: Any, c: Any = None) -> Any:
    a = a.T if attributes.get("transA") else a
    b = b.T if attributes.get("transB") else b
    product = attributes.get("alpha", 1.0) * (a @ b)
    if c is None:
        return product
    return product + attributes.get("beta", 1.0) * jnp.broadcast_to(c, product.shape)


def _clip(attributes: Attributes, x: Any, low: Any = None, high: Any = None) -> Any:
    x = x if low is None else jnp.maximum(x, low)
    return x if high is None else jnp.minimum(x, high)


def _reshape(attributes: Attributes, x: Any, shape: tuple[int, ...]) -> Any:
    if not attributes.get("allowzero"):
        shape = tuple(x.shape[i] if size == 0 else size for i, size in enumerate(shape))
    return x.reshape(shape)


def _flatten(attributes: Attributes, x: Any) -> Any:
    axis = attributes.get("axis", 1)
    return x.reshape(int(np.prod(x.shape[:axis])), -1)


def _slice(
    attributes: Attributes,
    x: Any,
    starts: tuple[int, ...],
    ends: tuple[int, ...],
    axes: tuple[int, ...] | None = None,
    steps: tuple[int, ...] | None = None,
) -> Any:
    axes, steps = axes or tuple(range(len(starts))), steps or (1,) * len(starts)
    index = [slice(None)] * x.ndim
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        size = x.shape[axis]
        # ONNX writes "from the end to before the start" as a very small end.
        stop = None if step < 0 and end < -size else end
        index[axis] = slice(start, stop, step)
    return x[tuple(index)]


def _gather(attributes: Attributes, x: Any, indices: int | tuple[int, ...]) -> Any:
    axis = attributes.get("axis", 0)
    places = np.asarray(indices, np.int32)
    if (places < -x.shape[axis]).any() or (places >= x.shape[axis]).any():
        raise ValueError("an index is out of range")
    return jnp.take(x, places % x.shape[axis], axis=axis)


def _split(attributes: Attributes, x: Any, sizes: tuple[int, ...] | None = None) -> list[Any]:
    axis = attributes.get("axis", 0)
    if sizes is None:
        return jnp.split(x, attributes["num_outputs"], axis)
    if sum(sizes) != x.shape[axis]:
        raise ValueError("the parts of a Split are not the whole")
    return jnp.split(x, np.cumsum(sizes)[:-1].tolist(), axis)


def _layer_norm(attributes: Attributes, x: Any, scale: Any, bias: Any = None) -> Any:
    axis = attributes.get("axis", -1)
    axes = tuple(range(axis % x.ndim, x.ndim))
    centred = x - x.mean(axes, keepdims=True)
    variance = jnp.square(centred).mean(axes, keepdims=True)
    normed = centred / jnp.sqrt(variance + attributes.get("epsilon", 1e-5))
    normed = normed * jnp.broadcast_to(scale, x.shape)
    return normed if bias is None else normed + jnp.broadcast_to(bias, x.shape)


def _batch_norm(
    attributes: Attributes, x: Any, scale: Any, bias: Any, mean: Any, variance: Any
) -> Any:
    """Normalise by the stored statistics. Graphs that use a batch's statistics are refused."""
    channels = (1, -1, *(1,) * (x.ndim - 2))
    scale, bias, mean, variance = (
        value.reshape(channels) for value in (scale, bias, mean, variance)
    )
    deviation = jnp.sqrt(variance + attributes.get("epsilon", 1e-5))
    return (x - mean) / deviation * scale + bias


def _reducing(how: Callable[..., Any]) -> Callable[..., Any]:
    def reduce(attributes: Attributes, x: Any, axes: tuple[int, ...] | None = None) -> Any:
        axes = axes or attributes.get("axes")
        if not axes and attributes.get("noop_with_empty_axes"):
            return x
        return how(x, axes, keepdims=bool(attributes.get("keepdims", 1)))

    return reduce


def _hard_sigmoid(attributes: Attributes, x: Any) -> Any:
    scaled = attributes.get("alpha", 0.2) * x + attributes.get("beta", 0.5)
    return jnp.clip(scaled, 0.0, 1.0)


def _selu(attributes: Attributes, x: Any) -> Any:
    alpha = attributes.get("alpha", 1.67326319217681884765625)
    return attributes.get("gamma", 1.05070102214813232421875) * jax.nn.elu(x, alpha)


def _gelu(attributes: Attributes, x: Any) -> Any:
    approximate = attributes.get("approximate", "none")
    if approximate not in ("none", "tanh"):
        raise ValueError("an unknown form of Gelu")
    return jax.nn.gelu(x, approximate=approximate == "tanh")


def _elementwise(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda attributes, *inputs: function(*jnp.broadcast_arrays(*inputs))


OPERATORS: dict[str, Callable[..., Any]] = {
    "Abs": _simple(jnp.abs),
    "Add": _elementwise(jnp.add),
    "BatchNormalization": _batch_norm,
    "Cast": _simple(lambda x: x.astype(jnp.float32)),
    "Clip": _clip,
    "Concat": lambda attributes, *inputs: jnp.concatenate(inputs, attributes["axis"]),
    "Div": _elementwise(jnp.divide),
    "Dropout": lambda attributes, x, *_: x,  # in training mode it is refused before
    "Elu": lambda attributes, x: jax.nn.elu(x, attributes.get("alpha", 1.0)),
    "Erf": _simple(jax.scipy.special.erf),
    "Exp": _simple(jnp.exp),
    "Flatten": _flatten,
    "Gather": _gather,
    "Gelu": _gelu,
    "Gemm": _gemm,
    "Greater": _elementwise(jnp.greater),
    "GreaterOrEqual": _elementwise(jnp.greater_equal),
    "HardSigmoid": _hard_sigmoid,
    "HardSwish": _simple(lambda x: x * jnp.clip(x / 6.0 + 0.5, 0.0, 1.0)),
    "Identity": _simple(lambda x: x),
    "LayerNormalization": _layer_norm,
    "LeakyRelu": lambda attributes, x: jax.nn.leaky_relu(x, attributes.get("alpha", 0.01)),
    "Less": _elementwise(jnp.less),
    "LessOrEqual": _elementwise(jnp.less_equal),
    "Log": _simple(jnp.log),
    "LogSoftmax": lambda attributes, x: jax.nn.log_softmax(x, attributes.get("axis", -1)),
    "MatMul": _simple(jnp.matmul),
    "Max": _elementwise(jnp.maximum),
    "Min": _elementwise(jnp.minimum),
    "Mish": _simple(lambda x: x * jnp.tanh(jax.nn.softplus(x))),
    "Mul": _elementwise(jnp.multiply),
    "Neg": _simple(jnp.negative),
    "PRelu": _elementwise(lambda x, slope: jnp.where(x < 0.0, slope * x, x)),
    "Pow": _elementwise(lambda x, power: jnp.power(x, power.astype(jnp.float32))),
    "Reciprocal": _simple(jnp.reciprocal),
    "ReduceMean": _reducing(jnp.mean),
    "ReduceSum": _reducing(jnp.sum),
    "Relu": _simple(jax.nn.relu),
    "Reshape": _reshape,
    "Selu": _selu,
    "Sigmoid": _simple(jax.nn.sigmoid),
    "Slice": _slice,
    "Softmax": lambda attributes, x: jax.nn.softmax(x, attributes.get("axis", -1)),
    "Softplus": _simple(jax.nn.softplus),
    "Softsign": _simple(jax.nn.soft_sign),
    "Split": _split,
    "Sqrt": _simple(jnp.sqrt),
    "Squeeze": _simple(jnp.squeeze),
    "Sub": _elementwise(jnp.subtract),
    "Tanh": _simple(jnp.tanh),
    "Transpose": lambda attributes, x: jnp.transpose(x, attributes.get("perm")),
    "Unsqueeze": _simple(jnp.expand_dims),
    "Where": _elementwise(jnp.where),
}
