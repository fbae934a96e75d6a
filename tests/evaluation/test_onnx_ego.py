"""A robot from an ONNX file, held against the same policy as ours."""

from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evaluation.egos import EgoError, call_ego, read_egos
from evaluation.jobs import HostEgo
from population.onnx_export import to_onnx
from population.policy import Policy
from population.spec import PolicySpec
from zoo.registry import Registry

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

EMPTY = Registry(data=cast(Any, None), path=Path("registry.json"), policies=[])
MLP = PolicySpec("robot", 5, 2, hidden=(8,))
GRU = PolicySpec("robot", 5, 2, "gru", hidden=(8, 4))


def load(path: Path) -> HostEgo:
    (ego,) = read_egos([f"onnx:{path}"], EMPTY, "scratch")
    assert isinstance(ego, HostEgo)
    return ego


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


def test_its_digest_is_that_of_its_bytes(tmp_path: Path) -> None:
    write(tmp_path / "robot.onnx", MLP)
    one = load(tmp_path / "robot.onnx").member
    assert one.id == f"onnx:{tmp_path / 'robot.onnx'}"
    (tmp_path / "other.onnx").write_bytes(
        (tmp_path / "robot.onnx").read_bytes().replace(b"assistax-zoo", b"assistax_zoo")
    )
    assert load(tmp_path / "other.onnx").member.digest != one.digest


def test_a_wrong_width_is_told(tmp_path: Path) -> None:
    write(tmp_path / "robot.onnx", MLP)
    act = call_ego(load(tmp_path / "robot.onnx"), ("a",), episodes=3, action_size=2)
    with pytest.raises(EgoError, match="reads 5 observations, the environment gives 34"):
        act(np.zeros((3, 34), np.float32), 0)


@pytest.mark.parametrize("data", [b"", b"not a model", b"\x80\x04pickle."])
def test_what_is_no_model_is_refused_in_one_line(
    tmp_path: Path, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.onnx").write_bytes(data)
    with pytest.raises(ValueError, match="not an ONNX model") as caught:
        load(tmp_path / "robot.onnx")
    assert "\n" not in str(caught.value) and capfd.readouterr() == ("", "")


def test_a_model_of_another_form_is_refused(tmp_path: Path) -> None:
    helper, kind = onnx.helper, onnx.TensorProto.DOUBLE
    ends = [helper.make_tensor_value_info(name, kind, ["N", 5]) for name in ("x", "y")]
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "g", ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    (tmp_path / "robot.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ValueError, match=r"inputs x tensor\(double\).*expected float observations"):
        load(tmp_path / "robot.onnx")


def test_a_model_cannot_name_other_files(tmp_path: Path) -> None:
    """Weights in a file of their own would escape the digest, and read what they like."""
    write(tmp_path / "robot.onnx", MLP)
    model = onnx.load(str(tmp_path / "robot.onnx"))
    onnx.save(
        model,
        str(tmp_path / "apart.onnx"),
        save_as_external_data=True,
        location="weights",
        size_threshold=0,
    )
    with pytest.raises(ValueError, match="not an ONNX model that onnxruntime runs"):
        load(tmp_path / "apart.onnx")
