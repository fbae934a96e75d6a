"""Files as labs hand them in, good and bad, of many kinds, each drawn from a seed."""

import io
import json
import os
import pickle
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from population.networks.onnx_export import to_onnx
from population.networks.spec import PolicySpec
from tests.board.onnx_files import onnx_bytes
from tests.untrained import params_of
from zoo.parameters.storage import write_policy_file

Draw = np.random.Generator
WIDTHS = (8, 16)
COUNT = 200 if os.environ.get("ASSISTAX_ATTACK") else 86  # two of each kind


def robot_files() -> Iterator[tuple[str, bytes]]:
    """Yield files with the names of their kinds, which take turns."""
    kinds = list(KINDS)
    for seed in range(COUNT):
        kind = kinds[seed % len(kinds)]
        yield kind, KINDS[kind](np.random.default_rng(seed))


def _spec(rng: Draw, **changed: Any) -> PolicySpec:
    fields = {
        "role": "robot",
        "observation_size": 34,
        "action_size": 7,
        "hidden": (int(rng.choice(WIDTHS)),),
        "torso": rng.choice(["mlp", "gru"]).item(),
        "squash": rng.choice(["clip", "tanh"]).item(),
    }
    return PolicySpec(**fields | changed)


def _safetensors(
    rng: Draw, edit: Callable[[Any], Any] = lambda params: params, **spec: Any
) -> bytes:
    drawn = _spec(rng, **spec)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.safetensors"
        write_policy_file(path, drawn, edit(params_of(drawn, int(rng.integers(100)))))
        return path.read_bytes()


def _onnx(rng: Draw, edit: Callable[[Any], Any] = lambda model: None, **spec: Any) -> bytes:
    drawn = _spec(rng, **spec)
    model = onnx.load_from_string(to_onnx(drawn, params_of(drawn, int(rng.integers(100)))))
    edit(model)
    return model.SerializeToString()


def _leaves(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Any], Any]:
    """Return an edit of the first leaf of nested parameters."""

    def edit(params: Any) -> Any:
        name = min(params)
        inner = edit(params[name]) if isinstance(params[name], dict) else change(params[name])
        return {**params, name: inner}

    return edit


def _flipped(rng: Draw, data: bytes) -> bytes:
    damaged = bytearray(data)
    for place in rng.integers(0, len(data), rng.integers(1, 5)):
        damaged[place] = rng.integers(256)
    return bytes(damaged)


def _cut(rng: Draw, data: bytes) -> bytes:
    return data[: int(rng.integers(1, len(data)))]


def _zip(names: tuple[str, ...]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in names:
            archive.writestr(name, b"\x80\x04")
    return buffer.getvalue()


def _loop(model: Any) -> None:
    node = model.graph.node.add(op_type="Loop", output=["looped"])
    node.attribute.add(name="body", type=5).g.CopyFrom(onnx.GraphProto())


def _weights(value: float) -> Callable[[Any], None]:
    def edit(model: Any) -> None:
        for tensor in model.graph.initializer:
            if tensor.data_type == onnx.TensorProto.FLOAT:
                array = numpy_helper.to_array(tensor)
                filled = numpy_helper.from_array(np.full_like(array, value), tensor.name)
                tensor.CopyFrom(filled)

    return edit


def _random(model: Any) -> None:
    model.graph.node[-1].op_type = "RandomNormalLike"


def _header(size: int) -> Callable[[Draw], bytes]:
    return lambda rng: size.to_bytes(8, "little") + b'{"a":1}' + rng.bytes(50)


GOOD = {
    f"{torso} {squash} {name}": (
        lambda rng, make=make, torso=torso, squash=squash: make(rng, torso=torso, squash=squash)
    )
    for torso in ("mlp", "gru")
    for squash in ("clip", "tanh")
    for name, make in (("safetensors", _safetensors), ("onnx", _onnx))
}
# Of the files by which the reader of ONNX is tested.
READ_TOO = (
    *("wrong observations", "wrong actions", "double input", "external", "erf gelu"),
    *("other domain", "opset 9", "fixed batch of 4"),
)
KINDS: dict[str, Callable[[Draw], bytes]] = {
    **GOOD,
    "human": lambda rng: _safetensors(rng, role="human"),
    "another task": lambda rng: _safetensors(rng, observation_size=35),
    "fewer actions": lambda rng: _safetensors(rng, action_size=6),
    "overflow": lambda rng: _safetensors(rng, _leaves(lambda leaf: 0 * leaf + 3e38)),
    "nan, onnx": lambda rng: _onnx(rng, _weights(float("nan"))),
    "overflow, onnx": lambda rng: _onnx(rng, _weights(3e38), torso="mlp"),
    "other shape": lambda rng: _safetensors(rng, _leaves(lambda leaf: leaf[..., :-1])),
    "flipped": lambda rng: _flipped(rng, _safetensors(rng)),
    "flipped, onnx": lambda rng: _flipped(rng, _onnx(rng)),
    "cut": lambda rng: _cut(rng, _safetensors(rng)),
    "cut, onnx": lambda rng: _cut(rng, _onnx(rng)),
    "more behind": lambda rng: _safetensors(rng) + rng.bytes(9),
    "more behind, onnx": lambda rng: _onnx(rng) + rng.bytes(9),
    "empty": lambda rng: b"",
    "noise": lambda rng: rng.bytes(int(rng.integers(1, 4000))),
    "pickle": lambda rng: pickle.dumps({"w": rng.bytes(30)}),
    "torch": lambda rng: _zip(("archive/data.pkl", "archive/data/0")),
    "stable baselines": lambda rng: _zip(("policy.pth", "data")),
    "json": lambda rng: json.dumps({"weights": rng.normal(size=5).tolist()}).encode(),
    "huge header": _header(2**62),
    "small header": _header(7),
    **{name: lambda rng, name=name: onnx_bytes(name) for name in READ_TOO},
    "loop": lambda rng: _onnx(rng, _loop),
    "function": lambda rng: _onnx(rng, lambda m: m.functions.add(name="f", domain="mine")),
    "random operator": lambda rng: _onnx(rng, _random),
    "two opsets": lambda rng: _onnx(rng, lambda m: m.opset_import.add(domain="x", version=1)),
    "many nodes": lambda rng: _onnx(rng, lambda m: m.graph.node.extend([m.graph.node[0]] * 3000)),
    "too large": lambda rng: rng.bytes(1) * (16 * 1024 * 1024 + 1),
}
