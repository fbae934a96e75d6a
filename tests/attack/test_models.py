"""A hundred hostile models, archives and robots: one line, little memory, and no second chance."""

import gzip
import io
import itertools
import json
import resource
import struct
import tarfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from assistax_base.errors import ZooError
from evaluation.cast.egos import call_ego, read_egos
from population.networks.tensors import parse_stacked
from tests.attack.ledger import attack
from tests.attack.process import CONTEXT
from zoo.parameters.storage import read_policy_file
from zoo.registry import Registry

pytestmark = pytest.mark.attack
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
EMPTY = Registry(data=cast(Any, None), path=Path("registry.json"), policies=[])
SPEC = {"role": "robot", "observation_size": 5, "action_size": 2, "hidden": [4]}
HUGE = 1 << 40


def tensors(header: Any, data: bytes = bytes(64), size: int | None = None) -> bytes:
    """Return a safetensors file of a header, which may be text, and a size, which may be a lie."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if size is None else size) + text + data


def leaf(dtype: str = "F32", shape: Any = (4,), offsets: Any = (0, 16), **more: Any) -> bytes:
    """Return a safetensors file of one tensor and our metadata."""
    metadata = {"assistax": json.dumps({"spec": SPEC, "rows": ["x"]})}
    tensor = {"dtype": dtype, "shape": shape, "data_offsets": offsets}
    return tensors({"__metadata__": metadata, "log_std": tensor, **more})


def described(spec: Any, rows: Any = ("x",)) -> bytes:
    tensor = {"dtype": "F32", "shape": [4], "data_offsets": [0, 16]}
    text = json.dumps({"spec": spec, "rows": rows})
    return tensors({"__metadata__": {"assistax": text}, "log_std": tensor}, bytes(16))


def tar(name: str, size: int = 3, kind: bytes = tarfile.REGTYPE) -> bytes:
    """Return an archive with one member of a bad name, kind or size."""
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w") as archive:
        info = tarfile.TarInfo(name)
        info.type, info.linkname = kind, "/etc/passwd"
        archive.addfile(info, io.BytesIO(b"abc"))
    return content.getvalue()


SAFETENSORS: dict[str, bytes] = {
    "empty": b"",
    "seven bytes": bytes(7),
    "a header of 2**63": tensors(b"{}", size=1 << 63),
    "a header of 2**64-1": tensors(b"{}", size=(1 << 64) - 1),
    "a header longer than the file": tensors(b"{}", size=4096),
    "a header of 0": tensors(b"", size=0),
    "a deep header": tensors(b"[" * 500_000),
    "a header that is a list": tensors([]),
    "a header that is null": tensors(None),
    "a key twice": tensors(b'{"a": 1, "a": 2}'),
    "many keys": tensors(b"{" + b",".join(b'"a%d":0' % n for n in range(200_000)) + b"}"),
    "an unknown type": leaf("F7"),
    "text as type": leaf(cast(Any, None)),
    "bool": leaf("BOOL", (16,)),
    "int64": leaf("I64", (2,)),
    "bfloat16": leaf("BF16", (8,)),
    "float64": leaf("F64", (2,)),
    "complex": leaf("C64", (2,)),
    "a shape of 2**40": leaf(shape=(HUGE,)),
    "shapes that overflow": leaf(shape=(1 << 33, 1 << 33)),
    "a shape of minus one": leaf(shape=(-1,)),
    "a shape in words": leaf(shape="four"),
    "a hundred axes": leaf(shape=(1,) * 100 + (4,)),
    "no elements": leaf(shape=(0,), offsets=(0, 0)),
    "offsets backwards": leaf(offsets=(16, 0)),
    "offsets beyond": leaf(offsets=(0, HUGE)),
    "offsets below": leaf(offsets=(-16, 0)),
    "offsets in words": leaf(offsets=("a", "b")),
    "one offset": leaf(offsets=(0,)),
    "overlapping": leaf(b={"dtype": "F32", "shape": [4], "data_offsets": [8, 24]}),
    "a name with dots": leaf(
        **{"../../x": {"dtype": "F32", "shape": [1], "data_offsets": [16, 20]}}
    ),
    "a name with an escape": leaf(
        **{"\x1b[31m": {"dtype": "F32", "shape": [1], "data_offsets": [16, 20]}}
    ),
    "bytes after the end": leaf() + b"more",
    "not finite": leaf()[:-64] + np.full(16, np.nan, np.float32).tobytes(),
    "metadata that is no text": tensors({"__metadata__": {"assistax": 7}}),
    "metadata without ours": tensors({"__metadata__": {}}),
    "metadata that is a list": tensors({"__metadata__": []}),
    "no spec": described(None),
    "a spec of 2**40 units": described({**SPEC, "hidden": [HUGE]}),
    "a spec of minus one unit": described({**SPEC, "hidden": [-1]}),
    "a spec of a million layers": described({**SPEC, "hidden": [1] * 1_000_000}),
    "a spec of another role": described({**SPEC, "role": "\x1b[31mking"}),
    "a spec with strange fields": described({**SPEC, "__class__": "os.system"}),
    "rows that are a number": described(SPEC, 7),
    "a million rows": described(SPEC, ["x"] * 1_000_000),
    "a gzip bomb": gzip.compress(bytes(1 << 26)),
    "a tar with a path upwards": tar("../../escaped"),
    "a tar with an absolute path": tar("/tmp/escaped"),
    "a tar with a link": tar("link", kind=tarfile.SYMTYPE),
    "a tar with a device": tar("device", kind=tarfile.CHRTYPE),
    "a tar with a long name": tar("x" * 100_000),
    "a pickle": b"\x80\x04cos\nsystem\n(S'touch /tmp/escaped'\ntR.",
}


def graph(nodes: list[Any], constants: Any = (), columns: Any = 2, rows: Any = "N") -> bytes:
    """Return a model from `obs` [N, 5] to `act`."""
    make, real = onnx.helper, onnx.TensorProto.FLOAT
    made = make.make_graph(
        nodes,
        "g",
        [make.make_tensor_value_info("obs", real, [rows, 5])],
        [make.make_tensor_value_info("act", real, [rows, columns])],
        initializer=list(constants),
    )
    return make.make_model(made, opset_imports=[make.make_opsetid("", 17)]).SerializeToString()


def node(kind: str, inputs: str, output: str = "act", **attributes: Any) -> Any:
    return onnx.helper.make_node(kind, inputs.split(), output.split(), **attributes)


def numbers(name: str, *values: int) -> Any:
    return onnx.helper.make_tensor(name, onnx.TensorProto.INT64, [len(values)], values)


def external(place: str) -> bytes:
    tensor = onnx.helper.make_tensor("w", onnx.TensorProto.FLOAT, [5, 2], [0.0] * 10)
    tensor.ClearField("float_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=place)
    return graph([node("MatMul", "obs w")], [tensor])


def inner(kind: str) -> bytes:
    """Return a model with a graph within its graph."""
    make = onnx.helper
    body = make.make_graph([node("Identity", "obs", "b")], "body", [], [])
    names = {"If": ("then_branch", "else_branch"), "Loop": ("body",), "Scan": ("body",)}[kind]
    return graph([node(kind, "obs", **dict.fromkeys(names, body))])


def doubled(times: int) -> bytes:
    """Return a model that doubles its columns again and again."""
    names = ["obs", *(f"x{n}" for n in range(times - 1)), "act"]
    pairs = itertools.pairwise(names)
    return graph([node("Concat", f"{a} {a}", b, axis=1) for a, b in pairs])


def onnx_models() -> dict[str, bytes]:
    whole = graph([node("Identity", "obs")], columns=5)
    big = [numbers("shape", HUGE)]
    strangers = ("RandomNormalLike", "Loop", "NonZero", "Resize", "Scan", "StringNormalizer")
    return {
        "empty": b"",
        "text": b"hello",
        "half": whole[: len(whole) // 2],
        "a gzip bomb": gzip.compress(bytes(1 << 26)),
        "65 MB": bytes(65 << 20),
        "another width": whole,
        "a fixed batch": graph([node("Identity", "obs")], columns=5, rows=1),
        "12 GB": graph([node("ConstantOfShape", "shape")], [numbers("shape", 3 << 30)]),
        "2**40 numbers": graph([node("ConstantOfShape", "shape")], big),
        "expanded": graph([node("Expand", "obs shape")], [numbers("shape", HUGE, 1, 5)]),
        "negative": graph([node("ConstantOfShape", "shape")], [numbers("shape", -5)]),
        "doubled 40 times": doubled(40),
        "doubled 28 times": doubled(28),
        "not a number": graph([node("Log", "obs")], columns=5),
        "an output that nobody makes": graph([node("Identity", "obs", "x")]),
        "a ring": graph([node("Identity", "b", "a"), node("Identity", "a", "b")]),
        "weights elsewhere": external("weights.bin"),
        "weights upwards": external("../../../etc/passwd"),
        "weights of a device": external("/dev/zero"),
        "a domain of its own": graph([node("Identity", "obs", domain="evil")]),
        "an unknown operator": graph([node("Evil\x1b[31m", "obs")]),
        **{f"a graph in a graph, {kind}": inner(kind) for kind in ("If", "Loop", "Scan")},
        **{f"operator {kind}": graph([node(kind, "obs")]) for kind in strangers},
    }


ROBOTS = {
    "exits with 0": "import sys\ndef make(): sys.exit(0)",
    "exits when asked": "import sys\ndef make(): return lambda obs: sys.exit(0)",
    "ends at once": "import os\ndef make(): return lambda obs: os._exit(0)",
    "kills itself": "import os\ndef make(): return lambda obs: os.kill(os.getpid(), 9)",
    "raises GeneratorExit": "def make(): raise GeneratorExit",
    "raises KeyboardInterrupt": "def make():\n def act(obs): raise KeyboardInterrupt\n return act",
    "raises BaseException": "def make():\n def act(obs): raise BaseException('x')\n return act",
    "raises escapes": "def make(): raise ValueError('\\x1b]0;owned\\x07')",
    "raises a long line": "def make(): raise ValueError('x' * 10**8)",
    "recurses": "def make(): return make()",
    "answers None": "def make(): return lambda obs: None",
    "answers text": "def make(): return lambda obs: 'left'",
    "answers another shape": "def make(): return lambda obs: obs[:1]",
    "answers 2**30 numbers": "import numpy as n\n"
    "def make(): return lambda o: n.zeros((2**15, 2**15), bool)",
    "answers 2**30 bytes": "import numpy as n\n"
    "def make(): return lambda o: n.zeros((2**15, 2**15), n.uint8)",
    "answers by hand that 2**40 bytes follow": "import os, struct\n"
    "def make(): return lambda o: [os.write(n, struct.pack('<IQ', 2, 2**40)) for n in range(3, 9)]",
    "answers NaN": "def make(): return lambda obs: obs[:, :2] * float('nan')",
    "answers objects": "import numpy as n\ndef make(): return lambda o: n.array([{}] * len(o))",
    "prints": "def make():\n print('{' * 10**6)\n return lambda obs: print(obs)",
    "closes its pipes": "import os\ndef make(): return lambda o: [os.close(n) for n in range(9)]",
    "is no function": "make = 7",
    "is no Python": "def make(:",
    "lacks the function": "x = 1",
}


def refused(work: Callable[[], object]) -> None:
    """Work that ends with one short line of text, or with finite actions."""
    try:
        work()
    except (ZooError, ValueError, OSError) as error:
        text = str(error)
        assert len(text) < 3000 and "\x1b" not in text and "\n" not in text, text[:300]


def play(reference: str) -> None:
    roster = read_egos([reference], EMPTY, "scratch")
    act = call_ego(roster.stacks[0], ["t/a-d1-s0-v0/human"], episodes=4, action_size=2)
    for step in range(2):
        assert np.isfinite(act(np.ones((4, 5), np.float32), step)).all()


def attack_models(folder: Path) -> None:
    models = onnx_models()
    assert len(SAFETENSORS) + len(models) + len(ROBOTS) >= 100
    with attack("hostile models") as ledger:
        cases: list[tuple[str, Callable[[], object]]] = []
        for number, (name, data) in enumerate(SAFETENSORS.items()):
            path = folder / f"{number}.safetensors"
            path.write_bytes(data)
            cases.append((f"safetensors, {name}", lambda path=path: read_policy_file(path)))
            cases.append((f"stacked, {name}", lambda data=data: parse_stacked(data, "test")))
        for number, (name, data) in enumerate(models.items()):
            path = folder / f"{number}.onnx"
            path.write_bytes(data)
            cases.append((f"onnx, {name}", lambda path=path: play(f"onnx:{path}")))
        for number, (name, code) in enumerate(ROBOTS.items()):
            path = folder / f"robot{number}.py"
            path.write_text(code)
            cases.append((f"python, {name}", lambda path=path: play(f"python:{path}:make")))
        ledger.random.shuffle(cases)
        cases = cases[: ledger.wanted(len(cases))]
        # Last the robots that are the user's own code, which may take what the user's machine has.
        for name, work in sorted(cases, key=lambda case: case[0].startswith("python")):
            with ledger.trial(name):
                refused(work)
                taken = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss << 10
                assert name.startswith("python") or taken < 1 << 30, f"{taken >> 20} MiB"


def test_models_archives_and_robots(tmp_path: Path) -> None:
    # In a process of its own: the kernel tells the most that any ended child ever took, which in
    # this one may have been another test's.
    with ProcessPoolExecutor(1, mp_context=CONTEXT) as alone:
        alone.submit(attack_models, tmp_path).result()
    assert not list(Path("/tmp").glob("escaped*"))
