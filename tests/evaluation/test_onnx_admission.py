"""ONNX as JAX: equal to onnxruntime for every operator, and nothing else is let in."""

import contextlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from evaluation.cast.onnx_robots import admission as onnx_admission
from evaluation.cast.onnx_robots import ego as onnx_ego
from evaluation.cast.onnx_robots import program as onnx_program
from evaluation.cast.onnx_robots.admission import ATTRIBUTES, admit_onnx
from evaluation.cast.onnx_robots.ego import UntrustedModelError
from population.networks.onnx_export import to_onnx
from population.networks.policy import Policy
from population.networks.spec import PolicySpec

OBS, ACT = 6, 3
RNG = np.random.default_rng(0)

UNARY = """
Tanh Relu Sigmoid Abs Neg Exp Identity Elu LeakyRelu Softplus Erf HardSigmoid HardSwish LogSoftmax
Selu Softsign Gelu Mish
"""
# Each operator as (nodes from x [1, 6] to y, constants).
CASES: dict[str, tuple[list[Any], dict[str, Any]]] = {
    "Gemm": ([("Gemm", "x w b", {"alpha": 0.5, "beta": 2.0})], {"w": (6, 3), "b": (3,)}),
    "Gemm transposed": ([("Gemm", "x w", {"transB": 1})], {"w": (3, 6)}),
    "MatMul": ([("MatMul", "x w", {})], {"w": (6, 3)}),
    **{op: ([(op, "x w", {})], {"w": (6,)}) for op in ("Add", "Sub", "Mul", "Div", "Max", "Min")},
    **{op: ([(op, "x", {})], {}) for op in UNARY.split()},
    "Sqrt": ([("Abs", "x", {}), ("Sqrt", "y0", {})], {}),
    "Clip": ([("Clip", "x low high", {})], {"low": np.float32(-0.2), "high": np.float32(0.3)}),
    "Clip above": ([("Clip", "x  high", {})], {"high": np.float32(0.3)}),
    "Concat": ([("Concat", "x x", {"axis": -1})], {}),
    "Flatten": ([("Reshape", "x s", {}), ("Flatten", "y0", {})], {"s": [1, 2, 3]}),
    "Reshape": ([("Reshape", "x s", {}), ("Reshape", "y0 r", {})], {"s": [0, 2, -1], "r": [1, -1]}),
    "Squeeze": ([("Unsqueeze", "x a", {}), ("Squeeze", "y0 a", {})], {"a": [1]}),
    "Slice": ([("Slice", "x s e a t", {})], {"s": [1], "e": [5], "a": [1], "t": [2]}),
    "Slice backwards": (
        [("Slice", "x s e a t", {})],
        {"s": [-1], "e": [-(2**31)], "a": [1], "t": [-1]},
    ),
    "Gather": ([("Gather", "x i", {"axis": 1})], {"i": [4, 0, -1]}),
    "Gather one": (
        [("Gather", "x i", {"axis": 1}), ("Unsqueeze", "y0 a", {})],
        {"i": np.int64(2), "a": [1]},
    ),
    "Softmax": ([("Softmax", "x", {"axis": -1})], {}),
    "Transpose": (
        [("Reshape", "x s", {}), ("Transpose", "y0", {"perm": [0, 2, 1]}), ("Reshape", "y1 r", {})],
        {"s": [1, 2, 3], "r": [1, 6]},
    ),
    "LayerNormalization": (
        [("LayerNormalization", "x w b", {"axis": -1, "epsilon": 1e-3})],
        {"w": (6,), "b": (6,)},
    ),
    "ReduceMean": ([("ReduceMean", "x", {"axes": [1], "keepdims": 1})], {}),
    "Cast": ([("Cast", "x", {"to": TensorProto.FLOAT})], {}),
    "Log": ([("Abs", "x", {}), ("Log", "y0", {})], {}),
    "Reciprocal": ([("Exp", "x", {}), ("Reciprocal", "y0", {})], {}),
    "HardSigmoid of its own": ([("HardSigmoid", "x", {"alpha": 0.3, "beta": 0.4})], {}),
    "Selu of its own": ([("Selu", "x", {"alpha": 1.5, "gamma": 2.0})], {}),
    "PRelu": ([("PRelu", "x w", {})], {"w": (6,)}),
    "Pow": ([("Abs", "x", {}), ("Pow", "y0 w", {})], {"w": (6,)}),
    "Pow of a negative": ([("Pow", "x i", {})], {"i": np.int64(2)}),
    "BatchNormalization": (
        [("BatchNormalization", "x w b m v", {"epsilon": 1e-3})],
        dict.fromkeys("wbmv", (6,)),
    ),
    "BatchNormalization of channels": (
        [("Reshape", "x s", {}), ("BatchNormalization", "y0 w b m v", {}), ("Reshape", "y1 r", {})],
        {"s": [1, 2, 3], "r": [1, 6], **dict.fromkeys("wbmv", (2,))},
    ),
    "Dropout": ([("Dropout", "x r", {})], {"r": np.float32(0.5)}),
    "Dropout that says so": (
        [("Dropout", "x r t", {})],
        {"r": np.float32(0.5), "t": np.bool_(False)},
    ),
    "ReduceSum": ([("ReduceSum", "x a", {"keepdims": 1})], {"a": [1]}),
    "Gather of int32": ([("Gather", "x i", {"axis": 1})], {"i": np.array([4, 0], np.int32)}),
    "ReduceSum of nothing": ([("ReduceSum", "x", {"noop_with_empty_axes": 1})], {}),
    **{
        op: ([(op, "x w", {}), ("Where", "y0 x w", {})], {"w": (6,)})
        for op in ("Greater", "GreaterOrEqual", "Less", "LessOrEqual")
    },
    "Gelu by tanh": ([("Gelu", "x", {"approximate": "tanh"})], {}),
}
OPSETS = {"Gelu": 20, "Mish": 18}  # of operators that are younger than the others'


@pytest.mark.parametrize("name", CASES)
def test_every_operator_is_as_onnxruntime_has_it(name: str) -> None:
    nodes, constants = CASES[name]
    data = model(nodes, constants, OPSETS.get(nodes[-1][0], 17))
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    x = RNG.normal(size=(1, OBS)).astype(np.float32)
    expected: Any = session.run(None, {"x": x})[0]
    program, params = admit_onnx(data, OBS, expected.shape[1])
    [output] = onnx_program.run(program, params, [jnp.asarray(x)])
    np.testing.assert_allclose(output, expected, rtol=2e-6, atol=2e-6)


def test_every_operator_has_a_case() -> None:
    tried = {node[0] for nodes, _ in CASES.values() for node in nodes}
    assert onnx_program.OPERATORS.keys() - tried == {"Split"}  # in the recurrent policy
    assert ATTRIBUTES.keys() <= onnx_program.OPERATORS.keys()
    assert onnx_program.OPERATORS.keys() < onnx_ego.RUNTIME_OPERATORS, (
        "what a service takes plays at home"
    )


@pytest.mark.slow_for("clip-mlp")
@pytest.mark.parametrize("torso", ["mlp", "gru"])
@pytest.mark.parametrize("squash", ["clip", "tanh"])
def test_own_exports_play_like_their_policies(torso: Any, squash: Any) -> None:
    spec = PolicySpec(
        "robot", OBS, ACT, torso=torso, squash=squash, hidden=(16, 8), activation="relu"
    )
    policy = Policy(spec)
    params = jax.tree.map(np.asarray, policy.init(jax.random.key(1)))
    program, weights = admit_onnx(to_onnx(spec, params), OBS, ACT)
    played = program.player()
    carries = policy.initial_carry((5,)), played.initial_carry((5,))
    for step in range(4):
        obs = jnp.asarray(RNG.normal(size=(5, OBS)), jnp.float32)
        first = jnp.full(5, step in (0, 2))
        next_carry, expected = policy.act(params, carries[0], obs, first)
        two, actual = played.act(weights, carries[1], obs, first)
        carries = next_carry, two
        np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_rows_cannot_see_each_other() -> None:
    """A product of the batch with itself would tell a robot about other episodes."""
    data = model([("Transpose", "x", {}), ("MatMul", "x y0", {}), ("MatMul", "y1 x", {})], {})
    program, params = admit_onnx(data, OBS, OBS)
    rows = jnp.asarray([np.full(OBS, value, np.float32) for value in (0.1, 0.2, 0.3)])
    _, action = program.player().act(params, (), rows, jnp.ones(3, bool))
    np.testing.assert_allclose(action, OBS * rows**3, rtol=1e-6)


@pytest.mark.parametrize(
    ("operator", "attributes"), [("Softmax", {"axis": 0}), ("ReduceMean", {"axes": [0]})]
)
def test_batch_reduction_is_refused(operator: str, attributes: Any) -> None:
    with pytest.raises(UntrustedModelError, match=rf"mixes the rows .*\({operator} over axis 0\)"):
        admit_onnx(model([(operator, "x", attributes)], {}), OBS, OBS)


def test_reduction_over_transposed_axis_is_accepted() -> None:
    turned = [("Transpose", "x", {}), ("Softmax", "y0", {"axis": 0}), ("Transpose", "y1", {})]
    admit_onnx(model(turned, {}), OBS, OBS)


def test_row_check_is_bounded_in_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From four rows 4^32 numbers would come; from the one that is played comes one."""
    monkeypatch.setattr(onnx_admission, "mixes_rows", lambda *_: pytest.fail("it was run"))
    grow = [("Slice", "x s e a", {}), ("Softmax", "y0", {"axis": 0})]
    for _ in range(5):
        last = f"y{len(grow) - 1}"
        grow += [("Reshape", f"{last} c", {}), ("Reshape", f"{last} r", {})]
        grow.append(("Mul", f"y{len(grow) - 2} y{len(grow) - 1}", {}))
    grow.append(("Reshape", f"y{len(grow) - 1} c", {}))
    shapes = {"s": [0], "e": [1], "a": [1], "c": [-1, 1], "r": [1, -1]}
    program, _ = admit_onnx(model(grow, shapes), OBS, 1)
    assert program.action_size == 1


def test_robots_of_one_graph_share_a_program() -> None:
    first, second = (
        admit_onnx(model([("MatMul", "x w", {})], {"w": (6, 3)}), OBS, ACT) for _ in "ab"
    )
    assert first[0] == second[0]
    assert hash(first[0]) == hash(second[0])
    assert not np.array_equal(first[1]["w0"], second[1]["w0"])


def refusal_code(data: bytes, actions: int = ACT) -> str:
    with pytest.raises(UntrustedModelError) as refusal:
        admit_onnx(data, OBS, actions)
    return refusal.value.code


def external(proto: Any) -> None:
    tensor = proto.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def subgraph(proto: Any) -> None:
    node = proto.graph.node.add(op_type="If", input=["c"], output=["z"])
    node.attribute.add(name="then_branch", type=5).g.CopyFrom(onnx.GraphProto())


def huge(proto: Any) -> None:
    proto.graph.initializer[0].dims[:] = [2**31, 2**31]


def renamed(proto: Any, **fields: str) -> None:
    for name, value in fields.items():
        setattr(proto.graph.node[0], name, value)


def seven_rows(proto: Any) -> None:
    proto.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 7


def loop(proto: Any) -> None:
    proto.graph.node[0].input[0] = proto.graph.node[0].output[0]


NAN = numpy_helper.from_array(np.full((6, 3), np.nan, np.float32), "w")
AXIS = helper.make_attribute("axis", 1)
UNLISTED: list[tuple[Callable[[Any], Any], str]] = [
    (external, "external_data"),
    (huge, "malformed"),
    (lambda proto: proto.functions.add(name="f", domain="mine"), "subgraph"),
    (subgraph, "subgraph"),
    (lambda proto: renamed(proto, domain="com.microsoft"), "operator_not_allowed"),
    (lambda proto: proto.opset_import.add(domain="com.microsoft", version=1), "opset_not_allowed"),
    (lambda proto: renamed(proto, op_type="RandomNormalLike"), "operator_not_allowed"),
    (lambda proto: proto.graph.node[0].attribute.append(AXIS), "operator_not_allowed"),
    (lambda proto: proto.graph.node.extend([proto.graph.node[0]] * 3000), "graph_too_large"),
    (lambda proto: proto.graph.initializer[0].CopyFrom(NAN), "not_finite"),
    (seven_rows, "wrong_interface"),
    (loop, "malformed"),
]


@pytest.mark.parametrize(("change", "code"), UNLISTED)
def test_unlisted_content_is_refused(change: Any, code: str) -> None:
    proto = onnx.load_from_string(model([("MatMul", "x w", {})], {"w": (6, 3)}))
    change(proto)
    assert refusal_code(proto.SerializeToString()) == code


def test_graph_with_large_values_is_refused() -> None:
    wide = {"a": np.ones((1, 2000), np.float32), "b": np.ones((2000, 1), np.float32)}
    bomb = model(
        [("MatMul", "x w", {}), ("Mul", "a b", {}), ("Mul", "y1 a", {})], {"w": (6, 3), **wide}
    )
    assert refusal_code(bomb) == "graph_too_large"


def test_graph_with_many_operations_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_admission, "MAX_PRODUCTS", 1000)
    squares = [("MatMul", "x w", {}), *[("MatMul", f"y{i} w", {}) for i in range(50)]]
    assert refusal_code(model(squares, {"w": (6, 6)}), 6) == "graph_too_large"


@pytest.mark.parametrize("seed", range(20))
def test_damaged_bytes_are_refused_or_play(seed: int) -> None:
    """Flipped and missing bytes: a refusal or a whole program, never another exception."""
    rng = np.random.default_rng(seed)
    data = bytearray(model([("Gemm", "x w b", {}), ("Tanh", "y0", {})], {"w": (6, 3), "b": (3,)}))
    for place in rng.integers(0, len(data), 3):
        data[place] = rng.integers(256)
    for bytes_ in (bytes(data), bytes(data[: rng.integers(len(data))])):
        with contextlib.suppress(UntrustedModelError):
            admit_onnx(bytes_, OBS, ACT)


def model(nodes: list[Any], constants: dict[str, Any], opset: int = 17) -> bytes:
    """Return a model from x [N, 6] through nodes (operator, inputs, attributes) to y0, y1, ..."""
    made, tensors = [], []
    for place, (operator, inputs, attributes) in enumerate(nodes):
        names = inputs.split(" ")
        made.append(helper.make_node(operator, names, [f"y{place}"], **attributes))
    for name, value in constants.items():
        if isinstance(value, tuple):
            value = RNG.uniform(0.5, 1.5, size=value).astype(np.float32)
        array = np.asarray(value, None if isinstance(value, np.generic | np.ndarray) else np.int64)
        tensors.append(numpy_helper.from_array(array, name))
    x = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", OBS])
    y = helper.make_tensor_value_info(f"y{len(nodes) - 1}", TensorProto.FLOAT, None)
    graph = helper.make_graph(made, "g", [x], [y], tensors)
    opsets = [helper.make_opsetid("", opset)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=8).SerializeToString()
