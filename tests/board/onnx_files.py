"""Small ONNX files of many kinds, as exporters write them and as strangers might."""

from collections.abc import Callable
from typing import Any

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper

OBS, ACT = 34, 7
FLOAT = TensorProto.FLOAT
RNG = np.random.default_rng(0)
WEIGHT = RNG.normal(size=(OBS, ACT)).astype(np.float32) / 6
BIAS = RNG.normal(size=ACT).astype(np.float32) / 6


def made(
    nodes: list[Any] | None = None,
    weights: dict[str, Any] | None = None,
    *,
    inputs: list[Any] | None = None,
    outputs: list[Any] | None = None,
    opset: int = 17,
    ir: int = 8,
) -> ModelProto:
    """Return a model of nodes, by default one layer from `x` [N, O] to `y` [N, A]."""
    if nodes is None:
        nodes = [node("Gemm", "x w b", "h"), node("Tanh", "h", "y")]
    given = {"w": WEIGHT, "b": BIAS} if weights is None else weights
    graph = helper.make_graph(
        nodes,
        "g",
        inputs or [value("x", ["N", OBS])],
        outputs or [value("y", ["N", ACT])],
        [numpy_helper.from_array(np.asarray(array), name) for name, array in given.items()],
    )
    sets = [helper.make_opsetid("", opset)]
    return helper.make_model(graph, opset_imports=sets, ir_version=ir)


def node(operator: str, inputs: str, outputs: str, **attributes: Any) -> Any:
    return helper.make_node(operator, inputs.split(" "), outputs.split(" "), **attributes)


def value(name: str, shape: list[Any], kind: int = FLOAT) -> Any:
    return helper.make_tensor_value_info(name, kind, shape)


LINEAR = node("MatMul", "x w", "y")


def edited(change: Callable[[ModelProto], Any], **options: Any) -> ModelProto:
    model = made(**options)
    change(model)
    return model


def then(*nodes: Any, **weights: Any) -> ModelProto:
    """Return one layer to `h` [N, A], and nodes from there to `y`."""
    first = node("Gemm", "x w b", "h")
    return made([first, *nodes], {"w": WEIGHT, "b": BIAS, **weights})


def carrying(*nodes: Any, first: bool = True, outputs: int = 2) -> ModelProto:
    """Return a recurrent model with a carry [N, A]."""
    steps = [node("MatMul", "x w", "h"), node("Add", "h carry", "s"), node("Tanh", "s", "y")]
    inputs = [value("x", ["N", OBS]), value("carry", ["N", ACT])]
    inputs += [value("first", ["N"], TensorProto.BOOL)] * first
    out = [value("y", ["N", ACT]), value("s", ["N", ACT])][:outputs]
    return made([*steps, *nodes], {"w": WEIGHT}, inputs=inputs, outputs=out)


def _metadata(key: bytes, text: bytes) -> Callable[[ModelProto], Any]:
    """Return an edit of the metadata; a placeholder of equal length is replaced in the bytes."""

    def edit(model: ModelProto) -> None:
        helper.set_model_props(model, {"k" * len(key): "v" * len(text)})
        data = model.SerializeToString().replace(b"k" * len(key), key, 1)
        model.Clear()
        model.MergeFromString(data.replace(b"v" * len(text), text, 1))

    return edit


def _external(model: ModelProto, location: str = "robot.onnx.data") -> None:
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", location


def _halves(model: ModelProto) -> None:
    for tensor in model.graph.initializer:
        halved = numpy_helper.to_array(tensor).astype(np.float16)
        tensor.CopyFrom(numpy_helper.from_array(halved, tensor.name))


def _float_data(model: ModelProto) -> None:
    for tensor in model.graph.initializer:
        numbers = numpy_helper.to_array(tensor).ravel().tolist()
        tensor.ClearField("raw_data")
        tensor.float_data.extend(numbers)


def _twice(model: ModelProto) -> None:
    model.graph.initializer.append(model.graph.initializer[0])


def _domain(model: ModelProto) -> None:
    model.graph.node[1].domain = "com.example"


def _short(model: ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.raw_data = tensor.raw_data[:-4]


def _unsorted(model: ModelProto) -> None:
    nodes = list(model.graph.node)[::-1]
    del model.graph.node[:]
    model.graph.node.extend(nodes)


def _weight_inputs(model: ModelProto) -> None:
    """As old exporters wrote it: weights are inputs with a default."""
    model.graph.input.extend([value("w", [OBS, ACT]), value("b", [ACT])])


def _as_constants(model: ModelProto) -> None:
    constants = [
        helper.make_node("Constant", [], [tensor.name], value=tensor)
        for tensor in model.graph.initializer
    ]
    nodes = list(model.graph.node)
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.node.extend([*constants, *nodes])


def _nameless(model: ModelProto) -> None:
    model.graph.node[0].name = model.graph.name = ""
    model.producer_name = "somebody"


def reordered(model: ModelProto) -> bytes:
    """Return bytes whose version comes last: protobuf lets fields come in any order."""
    version = model.ir_version
    model.ClearField("ir_version")
    rest = model.SerializeToString()
    return rest + b"\x08" + bytes([version])


def _lstm() -> ModelProto:
    rng = np.random.default_rng(1)
    weights = {
        "W": rng.normal(size=(1, 4 * ACT, OBS)).astype(np.float32) / 6,
        "R": rng.normal(size=(1, 4 * ACT, ACT)).astype(np.float32) / 6,
        "t": np.array([0]),
        "d": np.array([0, 1]),
    }
    nodes = [
        node("Unsqueeze", "x t", "u"),
        node("LSTM", "u W R", "v", hidden_size=ACT),
        node("Squeeze", "v d", "y"),
    ]
    return made(nodes, weights)


ONNX_FILES: dict[str, Callable[[], ModelProto | bytes]] = {
    "plain": made,
    "opset 13": lambda: made(opset=13),
    "opset 22": lambda: made(opset=22),
    "opset 11": lambda: made(opset=11),
    "opset 9": lambda: made(opset=9),
    "opset 23": lambda: made(opset=23, ir=10),
    "old ir": lambda: made(ir=4),
    "ir 3, weights are inputs": lambda: edited(_weight_inputs, ir=3),
    "constants": lambda: edited(_as_constants),
    "float_data": lambda: edited(_float_data),
    "half weights": lambda: then(
        node("Cast", "c", "d", to=FLOAT), node("Add", "h d", "y"), c=BIAS.astype(np.float16)
    ),
    "half throughout": lambda: edited(_halves),
    "double weights": lambda: then(
        node("Cast", "c", "d", to=FLOAT), node("Add", "h d", "y"), c=BIAS.astype(np.float64)
    ),
    "double input": lambda: made(
        [node("Cast", "x", "f", to=FLOAT), node("Gemm", "f w b", "y")],
        inputs=[value("x", ["N", OBS], TensorProto.DOUBLE)],
    ),
    "int32 indices": lambda: then(
        node("Gather", "h i", "y", axis=1), i=np.arange(ACT, dtype=np.int32)
    ),
    "int64 indices": lambda: then(node("Gather", "h i", "y", axis=1), i=np.arange(ACT)[::-1]),
    "unused int32": lambda: then(node("Tanh", "h", "y"), unused=np.int32(3)),
    "unused bool": lambda: then(node("Tanh", "h", "y"), unused=np.array([True])),
    "unused nan": lambda: then(node("Tanh", "h", "y"), unused=np.float32("nan")),
    "nan weight": lambda: made(weights={"w": WEIGHT, "b": BIAS * np.nan}),
    "fixed batch of 1": lambda: made(inputs=[value("x", [1, OBS])], outputs=[value("y", [1, ACT])]),
    "fixed batch of 4": lambda: made(inputs=[value("x", [4, OBS])], outputs=[value("y", [4, ACT])]),
    "free width": lambda: made(inputs=[value("x", ["N", "O"])]),
    "no shape": lambda: made(inputs=[helper.make_tensor_value_info("x", FLOAT, None)]),
    "one row": lambda: made(inputs=[value("x", [OBS])]),
    "wrong observations": lambda: made(
        [LINEAR], {"w": WEIGHT[:30]}, inputs=[value("x", ["N", 30])]
    ),
    "wrong actions": lambda: made([LINEAR], {"w": WEIGHT[:, :3]}, outputs=[value("y", ["N", 3])]),
    "wrong inner width": lambda: made([LINEAR], {"w": WEIGHT[:30]}),
    "two outputs": lambda: made(outputs=[value("y", ["N", ACT]), value("h", ["N", ACT])]),
    "second output of ints": lambda: edited(
        lambda model: (
            model.graph.node.append(node("ArgMax", "h", "k")),
            model.graph.output.append(value("k", ["N", 1], TensorProto.INT64)),
        )
    ),
    "no output": lambda: edited(lambda model: model.graph.ClearField("output")),
    "output of nothing": lambda: made(outputs=[value("z", ["N", ACT])]),
    "unused input": lambda: made(inputs=[value("x", ["N", OBS]), value("z", ["N", 3])]),
    "recurrent": carrying,
    "recurrent without first": lambda: carrying(first=False),
    "recurrent without next carry": lambda: carrying(outputs=1),
    "lstm": _lstm,
    "batch normalisation": lambda: then(
        node("BatchNormalization", "h o z z o", "y"),
        o=np.ones(ACT, np.float32),
        z=np.zeros(ACT, np.float32),
    ),
    "dropout": lambda: then(node("Dropout", "h", "y")),
    "erf gelu": lambda: then(node("Erf", "h", "y")),
    "mean over rows": lambda: then(node("ReduceMean", "h", "y", axes=[0])),
    "softmax over rows": lambda: then(node("Softmax", "h", "y", axis=0)),
    "other domain": lambda: edited(_domain),
    "unsorted": lambda: edited(_unsorted),
    "weight twice": lambda: edited(_twice),
    "short weight": lambda: edited(_short),
    "external": lambda: edited(_external),
    "external elsewhere": lambda: edited(lambda model: _external(model, "../secret")),
    "metadata": lambda: edited(_metadata(b"assistax", b'{"env_version": 1}')),
    "metadata not utf-8": lambda: edited(_metadata(b"assistax", b"\xff\xfe caf\xe9")),
    "metadata key not utf-8": lambda: edited(_metadata(b"caf\xe9", b"{}")),
    "metadata not json": lambda: edited(_metadata(b"assistax", b"{nonsense")),
    "metadata a list": lambda: edited(_metadata(b"assistax", b"[1, 2]")),
    "metadata twice a key": lambda: edited(
        _metadata(b"assistax", b'{"env_version": 1, "env_version": 2}')
    ),
    "metadata nan": lambda: edited(_metadata(b"assistax", b'{"env_version": NaN}')),
    "version last": lambda: reordered(made()),
    "nameless": lambda: edited(_nameless),
    "no nodes": lambda: made([]),
    "empty": lambda: b"",
    "cut": lambda: made().SerializeToString()[:-40],
}


def onnx_bytes(name: str) -> bytes:
    content = ONNX_FILES[name]()
    return content if isinstance(content, bytes) else content.SerializeToString()
