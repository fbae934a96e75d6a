"""A robot from an ONNX file of any exporter, run by onnxruntime in its own process.

This is for networks that `evaluation.cast.onnx_robots.program` cannot play. Both use
`read_onnx_network`: a model is untrusted data, checked operator by operator before it is used.
"""

import resource
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 64 * 1024 * 1024  # size of a file: 16 million parameters
MEMORY = 768 * 1024 * 1024  # bytes for a model beside onnxruntime's own, 1 GB in all
# Operators without loops, calls, random numbers or access to files.
_PLAIN = """
Abs Add And ArgMax BatchNormalization Cast Ceil Clip Concat Constant ConstantOfShape Cos Div
Dropout Elu Equal Erf Exp Expand Flatten Floor GRU Gather Gelu Gemm Greater GreaterOrEqual
HardSigmoid HardSwish Identity LSTM LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax
MatMul Max Min Mish Mul Neg Not Or PRelu Pow RNN Reciprocal ReduceMax ReduceMean ReduceMin
ReduceSum Relu Reshape Round Selu Shape Sigmoid Sign Sin Slice Softmax Softplus Softsign Split
Sqrt Squeeze Sub Sum Swish Tanh Transpose Unsqueeze Where
"""
RUNTIME_OPERATORS = frozenset(_PLAIN.split())
# Operators that can reduce or pick along the first axis.
_REDUCING = frozenset(
    ["ArgMax", "Gather", "LogSoftmax", "Softmax"]
    + [f"Reduce{how}" for how in ("Max", "Mean", "Min", "Sum")]
)
ROWS = 4  # size of the batch that tests whether rows are independent


def factory(path: Path) -> tuple[str, str, dict[str, str]]:
    """Return module, function and arguments of the robot, for `evaluation.cast.policy_process`."""
    return __file__, make.__name__, {"path": str(path)}


def make(path: str) -> "OnnxEgo":
    """Return the robot of an ONNX file, after limiting this process's memory.

    Raises:
        ValueError: onnxruntime is not installed, or the file is not an accepted model.
    """
    try:
        import onnx  # noqa: F401
        import onnxruntime
    except ImportError:
        raise ValueError("needs onnxruntime: pip install 'assistax-zoo[export]'") from None
    data = read_bytes(Path(path))
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, taken + MEMORY))
    try:
        return OnnxEgo(data, onnxruntime, reductions_over_rows(read_onnx_network(data).graph))
    except (ValueError, MemoryError):
        raise
    # Each library has an exception class for each of its status codes.
    except Exception as error:
        message = " ".join(str(error).split())
        raise ValueError(f"is not an ONNX model that onnxruntime runs: {message[:300]}") from None


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a model's file.

    Raises:
        ValueError: There is no such file, or it is too large.
    """
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes; allowed are {MAX_BYTES}")
    return path.read_bytes()


def read_metadata(data: bytes) -> str | None:
    """Return the JSON text that `assistax-zoo export` wrote into a model, an unchecked claim.

    If there is no such text in UTF-8, return None.
    """
    properties = {entry.key: entry.value for entry in parse(data).metadata_props}
    text = properties.get("assistax")
    # protobuf returns bytes if the text is not UTF-8.
    return text if isinstance(text, str) else None


class UntrustedModelError(ValueError):
    """A model is refused; `code` is the reason for programs, the message is for people."""

    def __init__(self, code: str, message: str) -> None:
        self.code = code  # "malformed", "subgraph", "operator_not_allowed" or "external_data"
        super().__init__(message)


def read_onnx_network(data: bytes, operators: Collection[str] = RUNTIME_OPERATORS) -> Any:
    """Return the ONNX model in these bytes, checked to be a plain network of `operators`.

    Raises:
        UntrustedModelError: The bytes are no model, or it has other operators, subgraphs or weights
            in other files.
    """
    import onnx

    model = parse(data)
    if not model.graph.node:
        raise UntrustedModelError("malformed", "is not an ONNX model with a graph")
    _refuse_strangers(model, operators, onnx)
    return model


def parse(data: bytes) -> Any:
    """Return the ONNX model in these bytes, with unchecked content.

    Raises:
        UntrustedModelError: The bytes are no model.
    """
    import onnx

    model = onnx.ModelProto()
    try:
        model.ParseFromString(data)
    # protobuf has several exception classes.
    except Exception:
        raise UntrustedModelError("malformed", "is not an ONNX model") from None
    return model


def reductions_over_rows(graph: Any) -> list[str]:
    """Return the operators that reduce or pick along the first axis, the rows, in sorted order.

    After a transposition the first axis may be another one; `mixes_rows` tests that.
    """
    import onnx

    constants, names = _constants(graph), set()
    for node in graph.node:
        if node.op_type not in _REDUCING:
            continue
        reduces = node.op_type.startswith("Reduce")  # over all axes, if it names none
        axes = [0 if reduces or node.op_type in ("ArgMax", "Gather") else -1]
        for attribute in node.attribute:
            if attribute.name in ("axis", "axes"):
                axes = [*attribute.ints] or [attribute.i]
        if reduces and len(node.input) > 1 and node.input[1] in constants:
            axes = onnx.numpy_helper.to_array(constants[node.input[1]]).reshape(-1).tolist()
        if 0 in axes:
            names.add(node.op_type)
    return sorted(names)


def mixes_rows(
    answer: Callable[[list[np.ndarray]], Sequence[np.ndarray]],
    widths: Sequence[int],
    has_first: bool,
) -> bool:
    """Return whether a row of outputs depends on other rows of the inputs.

    Each row's output is compared with its output among other random rows, bit by bit, and with its
    output in a batch of one, within rounding.

    Args:
        answer: Maps inputs, the observations [N, O] and perhaps carry [N, H] and first [N], to
            outputs of N rows each.
        widths: O, or O and H.
        has_first: Whether `first` is an input.
    """
    rng = np.random.default_rng(0)

    def batch() -> list[np.ndarray]:
        rows = [rng.normal(size=(ROWS, width)).astype(np.float32) for width in widths]
        return [*rows, rng.random(ROWS) < 0.5] if has_first else rows

    inputs = batch()
    usual = answer(inputs)
    for row in range(ROWS):
        company = batch()
        for other, value in zip(company, inputs, strict=True):
            other[row] = value[row]
        alone = answer([value[row : row + 1] for value in inputs])
        for mine, beside_others, by_itself in zip(usual, answer(company), alone, strict=True):
            if not np.array_equal(mine[row], beside_others[row], equal_nan=True):
                return True
            if not np.allclose(mine[row], by_itself[0], rtol=1e-3, atol=1e-3, equal_nan=True):
                return True
    return False


def mixing_error(reducing: Sequence[str]) -> UntrustedModelError:
    """Return the error for a model whose rows depend on each other; `reducing` names operators."""
    names = f" ({', '.join(reducing)} over axis 0)" if reducing else ""
    return UntrustedModelError(
        "operator_not_allowed",
        f"mixes the rows of a batch{names}, which are different episodes; an action may depend on "
        "its own row of observations alone: reduce over the last axis",
    )


class OnnxEgo:
    """A callable from observations [B, O] to actions [B, A].

    The model's first input is the observations and its first output the actions. A recurrent model
    has two or three inputs: observations, carry [B, H] and optionally a bool [B] that is true on an
    episode's first step. Its second output is the next carry. `assistax-zoo export --format onnx`
    writes this form.
    """

    def __init__(self, data: bytes, onnxruntime: Any, reducing: Sequence[str] = ()) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        self._session = onnxruntime.InferenceSession(
            data, options, providers=["CPUExecutionProvider"]
        )
        # JSON text of `assistax-zoo export` about the policy, or None.
        self.metadata = self._session.get_modelmeta().custom_metadata_map.get("assistax")
        self._inputs, self._outputs = self._session.get_inputs(), self._session.get_outputs()
        self.recurrent = len(self._inputs) > 1  # whether it carries a state from step to step
        _check_form(self._inputs, self._outputs)
        self._reducing, self._rows_are_apart = reducing, False
        if isinstance(width := self._inputs[0].shape[1], int):
            self._check_rows(width)
        self.reset(1)

    def reset(self, rows: int) -> None:
        """Begin `rows` episodes."""
        self._first = True
        if self.recurrent:
            self._carry = np.zeros((rows, self._inputs[1].shape[1]), np.float32)

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Return the actions for observations [B, O]."""
        width = self._inputs[0].shape[1]
        if isinstance(width, int) and width != obs.shape[1]:
            raise ValueError(
                f"the model reads {width} observations, the environment gives {obs.shape[1]}"
            )
        if not self._rows_are_apart:
            self._check_rows(obs.shape[1])
        values: list[Any] = [obs.astype(np.float32, copy=False)]
        if self.recurrent:
            values += [self._carry, np.full(len(obs), self._first)]
        answer = self._run(values)
        self._first = False
        if self.recurrent:
            self._carry = answer[1]
        return answer[0]

    def _run(self, values: list[Any]) -> Any:
        fed = {value.name: array for value, array in zip(self._inputs, values, strict=False)}
        names = [value.name for value in self._outputs[: 1 + self.recurrent]]
        return self._session.run(names, fed)

    def _check_rows(self, width: int) -> None:
        widths = [width, self._inputs[1].shape[1]] if self.recurrent else [width]
        if mixes_rows(self._run, widths, len(self._inputs) == 3):
            raise mixing_error(self._reducing)
        self._rows_are_apart = True


def _refuse_strangers(model: Any, operators: Collection[str], onnx: Any) -> None:
    """Raise an `UntrustedModelError` if a model is not a plain network in one file."""
    graph, tensors = model.graph, list(model.graph.initializer)
    inner = {"functions of its own"} if model.functions or model.training_info else set()
    unknown = {"sparse weights"} if graph.sparse_initializer else set()
    kinds = onnx.AttributeProto
    for node in graph.node:
        name = f"{node.domain or 'ai.onnx'}.{node.op_type}"
        for value in node.attribute:
            tensors += [*([value.t] if value.HasField("t") else []), *value.tensors]
            if value.HasField("g") or value.graphs or value.type in (kinds.GRAPH, kinds.GRAPHS):
                inner.add(name)
        if node.domain not in ("", "ai.onnx") or node.op_type not in operators:
            unknown.add(name)
        elif _is_training(node, graph):
            unknown.add(f"{name} in training mode")
    if strange := inner | unknown:
        raise UntrustedModelError(
            "subgraph" if inner else "operator_not_allowed",
            f"uses {', '.join(sorted(strange))[:200]}; allowed are the operators of plain "
            "networks, without loops, branches and functions: export the network alone",
        )
    external = onnx.TensorProto.EXTERNAL
    if any(tensor.data_location == external or tensor.external_data for tensor in tensors):
        raise UntrustedModelError(
            "external_data",
            "keeps weights in other files, which its sha256 does not cover; save it as one file: "
            "torch.onnx.export(..., external_data=False)",
        )


def _is_training(node: Any, graph: Any) -> bool:
    """Return whether a node is in training mode: random dropout, or statistics of the batch."""
    if node.op_type == "BatchNormalization":
        modes = [value.i for value in node.attribute if value.name == "training_mode"]
        return any(modes) or sum(map(bool, node.output)) > 1
    if node.op_type != "Dropout" or len(node.input) < 3 or not node.input[2]:
        return False
    mode = _constants(graph).get(node.input[2])
    return mode is None or any(mode.raw_data) or any(mode.int32_data)


def _constants(graph: Any) -> dict[str, Any]:
    """Return the tensors that a graph stores, by name: initializers and constants."""
    constants = {tensor.name: tensor for tensor in graph.initializer}
    for node in graph.node:
        if node.op_type == "Constant":
            tensors = [value.t for value in node.attribute if value.HasField("t")]
            constants |= {name: tensor for name in node.output for tensor in tensors}
    return constants


def _check_form(inputs: Any, outputs: Any) -> None:
    forms = [(value.type, len(value.shape)) for value in inputs]
    allowed = [("tensor(float)", 2), ("tensor(float)", 2), ("tensor(bool)", 1)]
    whole = bool(forms) and forms == allowed[: len(forms)]
    whole = whole and len(outputs) >= 1 + (len(forms) > 1)
    if not whole or (len(forms) > 1 and not isinstance(inputs[1].shape[1], int)):
        listed = ", ".join(f"{value.name} {value.type}{value.shape}" for value in inputs)
        raise ValueError(
            f"has the inputs {listed or 'none'}; expected float observations [N, O], or those with "
            "a float carry [N, H] and a bool first [N], and the next carry as second output"
        )
    fixed = [value for value in (*inputs, *outputs[: len(inputs) > 1]) if _is_fixed(value)]
    if fixed:
        name, shape = fixed[0].name, fixed[0].shape
        raise ValueError(
            f"has a fixed batch: the first axis of {name} {shape} must be dynamic, for one row an "
            "episode; with torch.onnx.export: dynamic_shapes=({0: 'batch'},), or with "
            f"dynamo=False dynamic_axes={{{name!r}: {{0: 'batch'}}}}"
        )


def _is_fixed(value: Any) -> bool:
    return bool(value.shape) and isinstance(value.shape[0], int)
