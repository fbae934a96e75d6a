"""A robot from an ONNX file of any exporter, run by onnxruntime in a process of its own.

This is for one's own evaluations, with any plain network that onnxruntime runs. A service, which
plays the networks of strangers, makes JAX of them instead and takes fewer operators. Both read a
file by `read_plain`: a model is data from a stranger, checked operator by operator before anything
else sees it.
"""

import resource
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 64 * 1024 * 1024  # of a file: 16 million parameters
MEMORY = 768 * 1024 * 1024  # that a model may take beside onnxruntime's own, 1 GB with it
# Nothing that loops, calls, draws or reads files.
_PLAIN = """
Abs Add And ArgMax BatchNormalization Cast Ceil Clip Concat Constant ConstantOfShape Cos Div
Dropout Elu Equal Erf Exp Expand Flatten Floor GRU Gather Gelu Gemm Greater GreaterOrEqual
HardSigmoid HardSwish Identity LSTM LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax
MatMul Max Min Mish Mul Neg Not Or PRelu Pow RNN Reciprocal ReduceMax ReduceMean ReduceMin
ReduceSum Relu Reshape Round Selu Shape Sigmoid Sign Sin Slice Softmax Softplus Softsign Split
Sqrt Squeeze Sub Sum Swish Tanh Transpose Unsqueeze Where
"""
OPERATORS = frozenset(_PLAIN.split())


def factory(path: Path) -> tuple[str, str, dict[str, str]]:
    """Return module, function and arguments of the robot, for `evaluation.policy_process`."""
    return __file__, make.__name__, {"path": str(path)}


def make(path: str) -> "OnnxEgo":
    """Load a model, and bound this process's memory first.

    Raises:
        ValueError: onnxruntime is not installed, or the file is not a model of this form.
    """
    try:
        import onnx  # noqa: F401
        import onnxruntime
    except ImportError:
        raise ValueError("needs onnxruntime: pip install 'assistax-zoo[export]'") from None
    file = Path(path)
    if not file.is_file() or file.stat().st_size > MAX_BYTES:
        raise ValueError(f"no file of at most {MAX_BYTES} bytes there")
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, taken + MEMORY))
    data = file.read_bytes()
    try:
        read_plain(data)
        return OnnxEgo(data, onnxruntime)
    except (ValueError, MemoryError):
        raise
    except Exception as error:  # each library has an exception class for each of its status codes
        message = " ".join(str(error).split())
        raise ValueError(f"is not an ONNX model that onnxruntime runs: {message[:300]}") from None


class StrangerError(ValueError):
    """Why a model is not read, in a word for programs and a text for people."""

    def __init__(self, code: str, message: str) -> None:
        self.code = code  # "malformed", "subgraph", "operator_not_allowed" or "external_data"
        super().__init__(message)


def read_plain(data: bytes, operators: Collection[str] = OPERATORS) -> Any:
    """Return the ONNX model in these bytes, a plain network of these operators, in one file.

    Raises:
        StrangerError: It is something else.
    """
    import onnx

    model = onnx.ModelProto()
    try:
        model.ParseFromString(data)
    except Exception:  # an exception class of protobuf's, which has several
        raise StrangerError("malformed", "is not an ONNX model") from None
    if not model.graph.node:
        raise StrangerError("malformed", "is not an ONNX model with a graph")
    _refuse_strangers(model, operators, onnx)
    return model


class OnnxEgo:
    """A callable from observations [B, O] to actions [B, A].

    The model's first input is the observations and its first output the actions. A recurrent model
    has two or three inputs: observations, carry [B, H] and, if it wants to be told, a bool [B] that
    is true on an episode's first step; its second output is the next carry. This is what
    `assistax-zoo export --format onnx` writes.
    """

    def __init__(self, data: bytes, onnxruntime: Any) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        self._session = onnxruntime.InferenceSession(
            data, options, providers=["CPUExecutionProvider"]
        )
        # What `assistax-zoo export` says of the policy, as JSON.
        self.metadata = self._session.get_modelmeta().custom_metadata_map.get("assistax")
        self._inputs, self._outputs = self._session.get_inputs(), self._session.get_outputs()
        self.recurrent = len(self._inputs) > 1  # whether it carries a state from step to step
        _check_form(self._inputs, self._outputs)
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
        values: list[Any] = [obs.astype(np.float32, copy=False)]
        if self.recurrent:
            values += [self._carry, np.full(len(obs), self._first)]
        fed = {value.name: array for value, array in zip(self._inputs, values, strict=False)}
        names = [value.name for value in self._outputs[: 1 + self.recurrent]]
        answer = self._session.run(names, fed)
        self._first = False
        if self.recurrent:
            self._carry = answer[1]
        return answer[0]


def _refuse_strangers(model: Any, operators: Collection[str], onnx: Any) -> None:
    """Refuse what is not a plain network in one file."""
    graph, tensors = model.graph, list(model.graph.initializer)
    inner = {"functions of its own"} if model.functions or model.training_info else set()
    unknown = {"sparse weights"} if graph.sparse_initializer else set()
    kinds = onnx.AttributeProto
    for node in graph.node:
        name = f"{node.domain or 'ai.onnx'}.{node.op_type}"
        for each in node.attribute:
            tensors += [*([each.t] if each.HasField("t") else []), *each.tensors]
            if each.HasField("g") or each.graphs or each.type in (kinds.GRAPH, kinds.GRAPHS):
                inner.add(name)
        if node.domain not in ("", "ai.onnx") or node.op_type not in operators:
            unknown.add(name)
    if found := inner | unknown:
        raise StrangerError(
            "subgraph" if inner else "operator_not_allowed",
            f"uses {', '.join(sorted(found))[:200]}; allowed are the operators of plain networks, "
            "without loops, branches and functions: export the network alone",
        )
    external = onnx.TensorProto.EXTERNAL
    if any(tensor.data_location == external or tensor.external_data for tensor in tensors):
        raise StrangerError(
            "external_data",
            "keeps weights in other files, which its sha256 does not cover; save it as one file",
        )


def _check_form(inputs: Any, outputs: Any) -> None:
    found = [(value.type, len(value.shape)) for value in inputs]
    allowed = [("tensor(float)", 2), ("tensor(float)", 2), ("tensor(bool)", 1)]
    whole = bool(found) and found == allowed[: len(found)]
    whole = whole and len(outputs) >= 1 + (len(found) > 1)
    if not whole or (len(found) > 1 and not isinstance(inputs[1].shape[1], int)):
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
            f"episode; with torch.onnx.export: dynamic_axes={{{name!r}: {{0: 'batch'}}}}"
        )


def _is_fixed(value: Any) -> bool:
    return bool(value.shape) and isinstance(value.shape[0], int)
