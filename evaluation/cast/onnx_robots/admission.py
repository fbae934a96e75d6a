"""Turn the bytes of an ONNX file into a JAX program, or refuse them. No code of a file is executed.

The program (`evaluation.cast.onnx_robots.program`) is stacked and mapped like a partner. A service
plays only such programs. Every attribute and tensor is checked against a list. Shapes are computed
without values, so a graph that is too large is refused before memory is allocated.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from evaluation.cast.onnx_robots.ego import (
    ROWS,
    UntrustedModelError,
    mixes_rows,
    mixing_error,
    read_onnx_network,
    reductions_over_rows,
)

PROGRAM = "onnx_program 1"  # part of a robot's digest; raise it if a program's values change
MAX_NODES = 2000
MAX_TENSORS = 2000
MAX_INTEGERS = 4096  # in all shapes and indices together
MAX_ELEMENTS = 65_536  # of any value, for one observation
MAX_PRODUCTS = 20_000_000  # multiplications for one observation
OPSETS = range(13, 23)

# Attributes of each operator; any other attribute is refused with its operator.
ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "BatchNormalization": ("epsilon", "momentum", "training_mode"),
    "Cast": ("to",),
    "Concat": ("axis",),
    "Dropout": ("seed",),
    "Elu": ("alpha",),
    "Flatten": ("axis",),
    "Gather": ("axis",),
    "Gelu": ("approximate",),
    "Gemm": ("alpha", "beta", "transA", "transB"),
    "HardSigmoid": ("alpha", "beta"),
    "LayerNormalization": ("axis", "epsilon", "stash_type"),
    "LeakyRelu": ("alpha",),
    "LogSoftmax": ("axis",),
    "ReduceMean": ("axes", "keepdims", "noop_with_empty_axes"),
    "ReduceSum": ("keepdims", "noop_with_empty_axes"),
    "Reshape": ("allowzero",),
    "Selu": ("alpha", "gamma"),
    "Softmax": ("axis",),
    "Split": ("axis", "num_outputs"),
    "Transpose": ("perm",),
}
# Refusals after which onnxruntime may still play a user's own file. Other refusals are final.
PLAYED_APART = (
    "operator_not_allowed",
    "opset_not_allowed",
    "wrong_interface",
    "wrong_sizes",
    "shape_unknown",
    "graph_too_large",
)
CONSTANTS = ("value", "value_float", "value_floats", "value_int", "value_ints")


def admit_onnx(data: bytes, observation_size: int, action_size: int) -> tuple[Any, dict[str, Any]]:
    """Return the program of an ONNX file and its parameters.

    Raises:
        UntrustedModelError: The graph has a form or an operator that is not allowed, or other
            sizes.
    """
    program, params = read_program(data)
    if (program.observation_size, program.action_size) != (observation_size, action_size):
        sizes = f"{program.observation_size} numbers, and gives {program.action_size}"
        raise UntrustedModelError("wrong_sizes", f"reads {sizes}")
    return program, params


def read_program(data: bytes) -> tuple[Any, dict[str, Any]]:
    """Return the program of an ONNX file of any observation and action size, and its parameters.

    Raises:
        UntrustedModelError: The graph has a form or an operator that is not allowed.
    """
    from evaluation.cast.onnx_robots.program import OPERATORS

    model = read_onnx_network(data, {*OPERATORS, "Constant"})
    _check_model(model)
    graph = _Graph(model.graph)
    program, params = graph.program()
    action_size = _check_shapes(program, params)
    program = dataclasses.replace(program, action_size=action_size)
    _check_rows(model.graph, program, params)
    return program, params


def _check_model(model: Any) -> None:
    """Raise an `UntrustedModelError` for other operator sets, bad names or too large graphs."""
    sets = [(opset.domain, opset.version) for opset in model.opset_import]
    if any(domain not in ("", "ai.onnx") or version not in OPSETS for domain, version in sets):
        raise UntrustedModelError("opset_not_allowed", str(sets[:4]))
    graph = model.graph
    if any(not isinstance(name, str) for name in _names(graph)):
        raise UntrustedModelError("malformed", "has a name that is not text")
    if len(sets) != 1 or graph.quantization_annotation:
        raise UntrustedModelError("operator_not_allowed", "quantised weights, or several opsets")
    if len(graph.node) > MAX_NODES or len(graph.initializer) > MAX_TENSORS:
        raise UntrustedModelError("graph_too_large", f"has {len(graph.node)} nodes")


def _names(graph: Any) -> Iterator[Any]:
    """Yield every name in a graph; protobuf returns bytes for a name that is not UTF-8."""
    for values in (graph.initializer, graph.input, graph.output):
        yield from (value.name for value in values)
    for node in graph.node:
        yield from (node.op_type, node.domain, *node.input, *node.output)
        yield from (attribute.name for attribute in node.attribute)


class _Graph:
    """Reader of a graph into a program; it refuses unknown tensors, nodes and attributes."""

    def __init__(self, graph: Any) -> None:
        self._graph = graph
        self._weights: dict[str, np.ndarray] = {}
        self._integers: dict[str, int | tuple[int, ...]] = {}
        self._count = 0  # of integers
        self._nodes: list[Any] = []

    def program(self) -> tuple[Any, dict[str, Any]]:
        """Return the program and its parameters."""
        from evaluation.cast.onnx_robots.program import OnnxProgram

        used = {name for node in self._graph.node for name in node.input}
        used |= {value.name for value in self._graph.output}
        for tensor in self._graph.initializer:
            value = _array(tensor) if tensor.name in used else np.zeros(0, np.float32)
            self._keep(tensor.name, value)
        inputs = [value for value in self._graph.input if not self._is_known(value.name)]
        names = {value.name for value in inputs}
        for node in self._graph.node:
            self._read(node, names)
        widths = _check_inputs(inputs)
        outputs = tuple(value.name for value in self._graph.output)[: 1 + (len(widths) > 1)]
        if len(outputs) < 1 + (len(widths) > 1) or not set(outputs) <= names:
            raise UntrustedModelError("wrong_interface", "too few outputs")
        program = OnnxProgram(
            role="robot",
            observation_size=widths[0],
            # Replaced after the shapes are computed.
            action_size=1,
            carry_size=widths[1] if len(widths) > 1 else 0,
            inputs=tuple(value.name for value in inputs),
            outputs=outputs,
            weights=tuple(self._weights),
            constants=tuple(self._integers.items()),
            nodes=tuple(self._nodes),
        )
        return program, {f"w{i}": value for i, value in enumerate(self._weights.values())}

    def _is_known(self, name: str) -> bool:
        return name in self._weights or name in self._integers

    def _keep(self, name: str, value: np.ndarray) -> None:
        if not name or self._is_known(name):
            raise UntrustedModelError("malformed", "gives a name twice, or an empty one")
        if value.dtype.kind == "f":
            self._weights[name] = value.astype(np.float32)
            if not np.isfinite(self._weights[name]).all():
                raise UntrustedModelError("not_finite", "has a weight that is not finite")
        elif value.dtype in (np.int64, np.int32, np.bool_) and value.ndim <= 1:
            self._integers[name] = tuple(value.tolist()) if value.ndim else int(value)
            self._count += value.size
            if self._count > MAX_INTEGERS:
                raise UntrustedModelError("graph_too_large", "too many integers")
        else:
            raise UntrustedModelError("operator_not_allowed", f"a tensor of {value.dtype}")

    def _read(self, node: Any, names: set[str]) -> None:
        from evaluation.cast.onnx_robots.program import Node

        if node.op_type == "Constant":
            self._keep(node.output[0], _constant(node))
            return
        attributes = _attributes(node)
        unknown = [name for name in node.input if name and name not in names]
        if not all(self._is_known(name) for name in unknown):
            raise UntrustedModelError(
                "malformed", "has a node that reads what no node before it wrote"
            )
        fresh = [name for name in node.output if name]
        if len(fresh) != len(set(fresh)) or any(n in names or self._is_known(n) for n in fresh):
            raise UntrustedModelError("malformed", "gives a name twice")
        names.update(fresh)
        inputs, outputs = tuple(node.input), tuple(node.output)
        if node.op_type == "Split" and len(inputs) == 1:
            attributes["num_outputs"] = len(outputs)
        self._nodes.append(Node(node.op_type, inputs, outputs, tuple(attributes.items())))


def _attributes(node: Any) -> dict[str, Any]:
    """Return a node's attributes as numbers and tuples of numbers."""
    import onnx

    values: dict[str, Any] = {}
    for attribute in node.attribute:
        name = attribute.name
        if name not in ATTRIBUTES.get(node.op_type, ()) or attribute.ref_attr_name:
            raise UntrustedModelError("operator_not_allowed", f"{node.op_type} with {name[:40]}")
        value = onnx.helper.get_attribute_value(attribute)
        value = value.decode("latin-1") if isinstance(value, bytes) else value
        is_list = not isinstance(value, str) and hasattr(value, "__len__")
        values[name] = tuple(value) if is_list else value
    if node.op_type == "Cast" and values.get("to") != onnx.TensorProto.FLOAT:
        raise UntrustedModelError("operator_not_allowed", "Cast to anything but float")
    return values


def _constant(node: Any) -> np.ndarray:
    import onnx

    if len(node.attribute) != 1 or node.attribute[0].name not in CONSTANTS:
        raise UntrustedModelError("operator_not_allowed", "Constant of an unknown form")
    attribute = node.attribute[0]
    if attribute.name == "value":
        return _array(attribute.t)
    kind = np.float32 if "float" in attribute.name else np.int64
    return np.asarray(onnx.helper.get_attribute_value(attribute), kind)


def _array(tensor: Any) -> np.ndarray:
    """Return a tensor's values, after checking its size against its stored bytes."""
    import onnx

    kind = onnx.TensorProto
    kinds = {kind.FLOAT: 4, kind.FLOAT16: 2, kind.DOUBLE: 8, kind.INT64: 8, kind.INT32: 4}
    kinds[kind.BOOL] = 1
    if tensor.data_type not in kinds:
        raise UntrustedModelError("operator_not_allowed", "a tensor of neither floats nor integers")
    size = math.prod(tensor.dims)
    stored = len(tensor.raw_data) // kinds[tensor.data_type] if tensor.raw_data else 0
    stored += len(tensor.float_data) + len(tensor.int32_data) + len(tensor.int64_data)
    stored += len(tensor.double_data)
    if size != stored or any(dim < 0 for dim in tensor.dims):
        raise UntrustedModelError("malformed", "has a tensor of another size than it says")
    return onnx.numpy_helper.to_array(tensor)


def _check_inputs(inputs: list[Any]) -> list[int]:
    """Return the widths [O] or [O, H] of the inputs obs [N, O], carry [N, H], first [N]."""
    import onnx

    kinds = [onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT, onnx.TensorProto.BOOL]
    if not 1 <= len(inputs) <= 3:
        raise UntrustedModelError("wrong_interface", f"{len(inputs)} inputs")
    widths = []
    for place, (value, kind) in enumerate(zip(inputs, kinds, strict=False)):
        tensor = value.type.tensor_type
        shape = tensor.shape.dim
        if tensor.elem_type != kind or len(shape) != (1 if place == 2 else 2):
            raise UntrustedModelError("wrong_interface", f"input {value.name[:40]}")
        if shape[0].HasField("dim_value") and shape[0].dim_value != 1:
            raise UntrustedModelError(
                "wrong_interface",
                "the number of rows must be free, or 1: dynamic_shapes of torch.onnx.export",
            )
        if place < 2:
            if not 0 < shape[1].dim_value <= MAX_ELEMENTS:
                raise UntrustedModelError("wrong_interface", f"the width of {value.name[:40]}")
            widths.append(shape[1].dim_value)
    return widths


def _check_shapes(program: Any, params: dict[str, Any]) -> int:
    """Return the width of the actions; raise an `UntrustedModelError` if shapes do not fit."""
    try:
        shapes = _shapes(program, params, 1)
    except UntrustedModelError:
        raise
    # A tracer raises various exceptions if shapes do not fit.
    except Exception as error:
        raise UntrustedModelError("shape_unknown", type(error).__name__) from None
    widths = [shape[1] for shape in shapes if len(shape) == 2 and shape[0] == 1]
    if len(widths) < len(shapes) or not widths[0] or widths[1:] not in ([], [program.carry_size]):
        raise UntrustedModelError("wrong_sizes", f"gives {shapes}")
    return widths[0]


def _shapes(program: Any, params: dict[str, Any], rows: int) -> list[tuple[int, ...]]:
    """Return the outputs' shapes for a batch, without values; raise if they are too large."""
    import jax
    import jax.numpy as jnp

    from assistax_envs.own_settings import own_settings
    from evaluation.cast.onnx_robots import program as programs

    products = 0

    def watch(node: Any, inputs: list[Any], output: Any) -> None:
        nonlocal products
        if output.size > MAX_ELEMENTS * rows and node.operator not in ("Identity", "Transpose"):
            raise UntrustedModelError(
                "graph_too_large", f"{node.operator} makes {output.size} numbers"
            )
        if node.operator in ("Gemm", "MatMul"):
            products += output.size * inputs[0].shape[-1]
        products += output.size
        if products > MAX_PRODUCTS * rows:
            raise UntrustedModelError("graph_too_large", "too many operations for one observation")

    shapes = [(rows, program.observation_size), (rows, program.carry_size)]
    inputs = [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes]
    inputs.append(jax.ShapeDtypeStruct((rows,), jnp.bool_))
    weights = {name: jax.ShapeDtypeStruct(w.shape, w.dtype) for name, w in params.items()}
    with own_settings():
        outputs = jax.eval_shape(
            lambda weights, inputs: programs.run(program, weights, inputs, watch),
            weights,
            inputs[: len(program.inputs)],
        )
    return [output.shape for output in outputs]


def _check_rows(graph: Any, program: Any, params: dict[str, Any]) -> None:
    """Raise an `UntrustedModelError` if a graph mixes the rows of a batch.

    A program sees one row at a time, so its actions would differ from the model's.
    """
    from evaluation.cast.onnx_robots import program as programs

    [rows] = [v.type.tensor_type.shape.dim[0] for v in graph.input if v.name == program.inputs[0]]
    reducing = reductions_over_rows(graph)
    if rows.HasField("dim_value") or not reducing:
        return
    widths = [program.observation_size, program.carry_size][: min(len(program.inputs), 2)]

    def answer(inputs: list[Any]) -> list[np.ndarray]:
        return [np.asarray(out) for out in programs.run(program, params, inputs)]

    try:
        # Refuses a batch that is too large before memory is allocated for it.
        _shapes(program, params, ROWS)
        mixed = mixes_rows(answer, widths, len(program.inputs) == 3)
    except Exception:
        # The graph's shapes hold for one row only, so rows cannot mix.
        return
    if mixed:
        raise mixing_error(reducing)
