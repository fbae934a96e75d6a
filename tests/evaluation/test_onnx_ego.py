"""A robot from an ONNX file, held against the same policy as ours."""

import re
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evaluation.cast.egos import EgoError, call_ego, read_egos
from evaluation.cast.onnx_robots import ego as onnx_ego
from evaluation.cast.onnx_robots.admission import admit_onnx
from evaluation.cast.policy_process import PolicyError, PolicyProcess
from evaluation.cast.roster import HostEgo, Member
from evaluation.record.manifest import file_sha256
from population.networks.onnx_export import to_onnx
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from zoo.registry import Registry

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

EMPTY = Registry(data=cast(Any, None), path=Path("registry.json"), policies=[])
MLP = PolicySpec("robot", 5, 2, hidden=(8,))
GRU = PolicySpec("robot", 5, 2, "gru", hidden=(8, 4))


def load(path: Path) -> HostEgo:
    """Start the process, which would not be needed for most files of these tests."""
    try:
        return HostEgo(f"onnx:{path}", PolicyProcess(*onnx_ego.factory(path)))
    except PolicyError as error:
        raise ValueError(f"{path}: {error}") from None


def read(path: Path) -> Any:
    [stack] = read_egos([f"onnx:{path}"], EMPTY, "scratch").stacks
    return stack


def described(path: Path) -> Member:
    [member] = read_egos([f"onnx:{path}"], EMPTY, "scratch").members.values()
    return member


def write(path: Path, spec: PolicySpec) -> Any:
    params = jax.tree.map(lambda leaf: leaf + 0.3, Policy(spec).init(jax.random.key(0)))
    path.write_bytes(to_onnx(spec, params))
    return params


@pytest.mark.parametrize("spec", [MLP, GRU])
def test_two_episodes_are_those_of_the_policy(tmp_path: Path, spec: PolicySpec) -> None:
    params = write(tmp_path / "robot.onnx", spec)
    act = call_ego(load(tmp_path / "robot.onnx"), ("a", "b"), episodes=3, action_size=2)
    rng = np.random.default_rng(0)
    for _ in range(2):  # the second must not remember the first
        carry = Policy(spec).initial_carry((6,))
        for step in range(4):
            obs = rng.normal(size=(6, 5)).astype(np.float32)
            carry, expected = Policy(spec).act(
                params, carry, jnp.asarray(obs), jnp.full(6, step == 0)
            )
            np.testing.assert_allclose(act(obs, step), expected, atol=1e-5)


@pytest.mark.parametrize("spec", [MLP, GRU])
def test_admitted_file_is_played_as_program(tmp_path: Path, spec: PolicySpec) -> None:
    write(tmp_path / "robot.onnx", spec)
    stack = read(tmp_path / "robot.onnx")
    program, params = admit_onnx((tmp_path / "robot.onnx").read_bytes(), 5, 2)
    assert stack.spec == program
    assert stack.ids == (f"onnx:{tmp_path / 'robot.onnx'}",)
    for name, value in params.items():
        np.testing.assert_array_equal(stack.row(0)[name], value)


def test_other_files_play_in_their_process(tmp_path: Path) -> None:
    """And keep their claims."""
    path = tmp_path / "robot.onnx"
    save(path, [onnx.helper.make_node("Erf", ["x"], ["y"])])
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, {"assistax": '{"env_version": 1}'})
    path.write_bytes(model.SerializeToString())
    ego = read(path)
    assert isinstance(ego, HostEgo) and described(path).env_version == 1
    obs = np.full((3, 5), 0.5, np.float32)
    np.testing.assert_allclose(call_ego(ego, ("a",), 3, 5)(obs, 0), 0.5204999, rtol=1e-5)


def test_digest_names_player(tmp_path: Path) -> None:
    """A result by onnxruntime is not that of the program: their folders are of two jobs."""
    write(tmp_path / "program.onnx", MLP)
    save(tmp_path / "process.onnx", [onnx.helper.make_node("Erf", ["x"], ["y"])])
    for name, same in (("process.onnx", True), ("program.onnx", False)):
        path = tmp_path / name
        assert (described(path).digest == file_sha256(path)) is same
        assert described(path).files == ((path, file_sha256(path)),)


def test_digest_is_hash_of_bytes(tmp_path: Path) -> None:
    write(tmp_path / "robot.onnx", MLP)
    before, data = described(tmp_path / "robot.onnx"), (tmp_path / "robot.onnx").read_bytes()
    assert before.id == f"onnx:{tmp_path / 'robot.onnx'}"
    (tmp_path / "robot.onnx").write_bytes(data.replace(b"assistax-zoo", b"assistax_zoo"))
    assert described(tmp_path / "robot.onnx").digest != before.digest


def test_wrong_width_is_reported(tmp_path: Path) -> None:
    write(tmp_path / "robot.onnx", MLP)
    act = call_ego(load(tmp_path / "robot.onnx"), ("a",), episodes=3, action_size=2)
    with pytest.raises(EgoError, match="reads 5 observations, the environment gives 34"):
        act(np.zeros((3, 34), np.float32), 0)


@pytest.mark.parametrize("data", [b"", b"not a model", b"\x80\x04pickle."])
def test_malformed_model_gets_one_line(
    tmp_path: Path, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.onnx").write_bytes(data)
    with pytest.raises(ValueError, match="not an ONNX model") as caught:
        load(tmp_path / "robot.onnx")
    assert "\n" not in str(caught.value) and capfd.readouterr() == ("", "")
    # No place in this code is named.
    with pytest.raises(EgoError, match=r"robot.onnx': is not an ONNX model( with a graph)?$"):
        read(tmp_path / "robot.onnx")


def test_a_model_of_another_form_is_refused(tmp_path: Path) -> None:
    node = onnx.helper.make_node("Identity", ["x"], ["y"])
    save(tmp_path / "robot.onnx", [node], kind=onnx.TensorProto.DOUBLE)
    with pytest.raises(ValueError, match=r"inputs x tensor\(double\).*expected float observations"):
        load(tmp_path / "robot.onnx")


def save(
    path: Path,
    nodes: list[Any],
    inputs: Any = None,
    kind: int = onnx.TensorProto.FLOAT,
    **graph: Any,
) -> None:
    """Write a model from x [N, 5] to y [N, 5]."""
    helper = onnx.helper
    x, y = (helper.make_tensor_value_info(name, kind, ["N", 5]) for name in ("x", "y"))
    body = helper.make_graph(nodes, "g", inputs or [x], [y], **graph)
    sets = [helper.make_opsetid("", 17), helper.make_opsetid("mine", 1)]
    model = helper.make_model(body, opset_imports=sets, ir_version=8)
    path.write_bytes(model.SerializeToString())


def test_fixed_batch_error_names_axis(tmp_path: Path) -> None:
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    fixed = helper.make_tensor_value_info("obs", kind, [1, 5])
    save(tmp_path / "robot.onnx", [helper.make_node("Identity", ["obs"], ["y"])], [fixed])
    message = (
        r"the first axis of obs \[1, 5\] must be dynamic.*dynamic_axes=\{'obs': \{0: 'batch'\}\}"
    )
    with pytest.raises(ValueError, match=message):
        load(tmp_path / "robot.onnx")


def test_a_model_cannot_name_other_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights in another file would escape the digest, and could name any file."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "robot.onnx", MLP)
    model = onnx.load(str(tmp_path / "robot.onnx"))
    apart = {"save_as_external_data": True, "location": "weights", "size_threshold": 0}
    onnx.save(model, str(tmp_path / "apart.onnx"), **apart)
    with pytest.raises(ValueError, match="keeps weights in other files"):
        load(tmp_path / "apart.onnx")


def endless() -> list[Any]:
    """A loop whose condition stays true."""
    helper, types = onnx.helper, onnx.TensorProto
    ends = [helper.make_tensor_value_info(name, types.BOOL, []) for name in ("in", "out")]
    step = helper.make_tensor_value_info("i", types.INT64, [])
    node = helper.make_node("Identity", ["in"], ["out"])
    body = helper.make_graph([node], "body", [step, ends[0]], [ends[1]])
    true = helper.make_tensor("true", types.BOOL, [], [True])
    return [
        helper.make_node("Constant", [], ["on"], value=true),
        helper.make_node("Loop", ["", "on"], [], body=body),
        helper.make_node("Identity", ["x"], ["y"]),
    ]


def drawing(operator: str) -> list[Any]:
    """A model that adds random numbers to its answers."""
    attributes = {"shape": [1, 5]} if operator in ("RandomNormal", "RandomUniform") else {}
    drawn = onnx.helper.make_node(operator, [] if attributes else ["x"], ["drawn"], **attributes)
    return [drawn, onnx.helper.make_node("Add", ["x", "drawn"], ["y"])]


RANDOM = ("Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform")


@pytest.mark.parametrize(
    ("nodes", "named"),
    [
        (endless(), "ai.onnx.Loop"),
        ([onnx.helper.make_node("Relu", ["x"], ["y"], domain="mine")], "mine.Relu"),
        *((drawing(operator), f"ai.onnx.{operator}") for operator in RANDOM),
    ],
)
def test_forbidden_operators_are_named(tmp_path: Path, nodes: Any, named: str) -> None:
    save(tmp_path / "robot.onnx", nodes)
    for open_file in (load, read):
        with pytest.raises(ValueError, match=f"uses {named}; allowed are the operators of plain"):
            open_file(tmp_path / "robot.onnx")


TRUE, FALSE = np.array(True), np.array(False)
AXIS = np.array([0], np.int64)


def dropout(mode: Any) -> tuple[list[Any], dict[str, Any]]:
    node = onnx.helper.make_node("Dropout", ["x", "ratio", "mode"], ["y"])
    return [node], {"ratio": np.array(0.5, np.float32), "mode": mode}


def batch_norm(**training: Any) -> tuple[list[Any], dict[str, Any]]:
    names = ["scale", "bias", "mean", "variance"]
    outputs = ["y", "new_mean", "new_variance"] if training else ["y"]
    node = onnx.helper.make_node("BatchNormalization", ["x", *names], outputs, **training)
    return [node], dict.fromkeys(names, np.ones(5, np.float32))


def over_rows(operator: str, **attributes: Any) -> tuple[list[Any], dict[str, Any]]:
    inputs, constants = ["x"], {}
    if operator == "ReduceSum":
        inputs, constants = ["x", "axes"], {"axes": AXIS}
    reduced = onnx.helper.make_node(operator, inputs, ["reduced"], **attributes)
    return [reduced, onnx.helper.make_node("Sub", ["x", "reduced"], ["y"])], constants


def sequence() -> tuple[list[Any], dict[str, Any]]:
    """The rows of a batch as the steps of a sequence, as an unbatched RNN has them."""
    shapes = {"w": (1, 5, 5), "r": (1, 5, 5)}
    nodes = [
        onnx.helper.make_node("Unsqueeze", ["x", "one"], ["steps"]),
        onnx.helper.make_node("RNN", ["steps", "w", "r"], ["hidden"], hidden_size=5),
        onnx.helper.make_node("Squeeze", ["hidden", "both"], ["y"]),
    ]
    weights = {name: np.full(shape, 0.1, np.float32) for name, shape in shapes.items()}
    return nodes, {**weights, "one": np.array([1]), "both": np.array([1, 2])}


def tensors(constants: dict[str, Any]) -> list[Any]:
    return [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()]


@pytest.mark.parametrize(
    ("made", "named"),
    [
        (dropout(TRUE), "uses ai.onnx.Dropout in training mode"),
        (batch_norm(training_mode=1), "uses ai.onnx.BatchNormalization in training mode"),
        (over_rows("ReduceMean", axes=[0]), r"mixes the rows .*\(ReduceMean over axis 0\)"),
        (over_rows("ReduceMax"), r"mixes the rows .*\(ReduceMax over axis 0\)"),
        (over_rows("ReduceSum"), r"mixes the rows .*\(ReduceSum over axis 0\)"),
        (over_rows("Softmax", axis=0), r"mixes the rows .*\(Softmax over axis 0\)"),
        (sequence(), "mixes the rows of a batch, which are different episodes"),
    ],
)
def test_random_or_mixing_models_are_refused(tmp_path: Path, made: Any, named: str) -> None:
    nodes, constants = made
    save(tmp_path / "robot.onnx", nodes, initializer=tensors(constants))
    with pytest.raises(EgoError, match=named):
        read(tmp_path / "robot.onnx")


@pytest.mark.parametrize(
    "made", [dropout(FALSE), batch_norm(), over_rows("ReduceMax", axes=[1], keepdims=1)]
)
def test_external_weights_play(tmp_path: Path, made: Any) -> None:
    nodes, constants = made
    save(tmp_path / "robot.onnx", nodes, initializer=tensors(constants))
    ego = read(tmp_path / "robot.onnx")
    obs = np.random.default_rng(0).normal(size=(4, 5)).astype(np.float32)
    act = call_ego(ego, ("a",), 4, 5)
    np.testing.assert_array_equal(act(obs, 0)[1:3], act(obs, 0)[1:3])


def test_functions_are_refused(tmp_path: Path) -> None:
    save(tmp_path / "robot.onnx", [onnx.helper.make_node("Relu", ["x"], ["y"])])
    model = onnx.load(str(tmp_path / "robot.onnx"))
    node, sets = onnx.helper.make_node("Relu", ["a"], ["b"]), [onnx.helper.make_opsetid("", 17)]
    function = onnx.helper.make_function("mine", "Twice", ["a"], ["b"], [node], sets)
    model.functions.append(function)
    (tmp_path / "robot.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ValueError, match="functions of its own"):
        load(tmp_path / "robot.onnx")


def test_model_memory_is_limited(tmp_path: Path) -> None:
    helper = onnx.helper
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["big"]),
        helper.make_node("ReduceSum", ["big"], ["sum"], keepdims=0),
        helper.make_node("Add", ["x", "sum"], ["y"]),
    ]
    shape = onnx.numpy_helper.from_array(np.array([3_000_000_000], np.int64), "shape")
    save(tmp_path / "robot.onnx", nodes, initializer=[shape])
    assert (tmp_path / "robot.onnx").stat().st_size < 250
    with pytest.raises(ValueError, match=r"robot.onnx") as caught:
        call_ego(load(tmp_path / "robot.onnx"), ("a",), 3, 5)(np.zeros((3, 5), np.float32), 0)
    assert re.search("alloc|memory", str(caught.value), re.IGNORECASE)


def test_a_huge_file_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "robot.onnx").open("wb") as file:
        file.truncate(2**31)
    with pytest.raises(ValueError, match="has 2147483648 bytes; allowed are 67108864"):
        load(tmp_path / "robot.onnx")
