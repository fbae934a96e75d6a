"""What PyTorch's exporter writes by default plays: run by tools/frameworks.sh."""

import warnings
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from evaluation.cast.egos import EgoError, read_egos
from zoo.registry import Registry

torch = pytest.importorskip("torch", reason="see tools/frameworks.sh")
pytest.importorskip("onnxscript", reason="see tools/frameworks.sh")
pytestmark = pytest.mark.slow

nn: Any = torch.nn
EMPTY: Any = Registry(data=None, path=Path("registry.json"), policies=[])  # type: ignore[arg-type]


class Recurrent(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.cell, self.out = nn.GRUCell(34, 16), nn.Linear(16, 7)

    def forward(self, obs: Any, carry: Any) -> Any:
        carry = self.cell(obs, carry)
        return torch.tanh(self.out(carry)), carry


def layers(*between: Any) -> Any:
    return nn.Sequential(nn.Linear(34, 32), *between, nn.Linear(32, 7), nn.Tanh())


NETWORKS: dict[str, Any] = {
    "tanh": lambda: layers(nn.Tanh()),
    "relu": lambda: layers(nn.ReLU()),
    "gelu": lambda: layers(nn.GELU()),
    "silu and layer norm": lambda: layers(nn.LayerNorm(32), nn.SiLU()),
    "elu and batch norm": lambda: layers(nn.BatchNorm1d(32), nn.ELU()),
    "mish and dropout": lambda: layers(nn.Mish(), nn.Dropout(0.5)),
    "prelu and rms norm": lambda: layers(nn.PReLU(), nn.RMSNorm(32)),
    "softplus": lambda: layers(nn.Softplus()),
    "gru": Recurrent,
}


def export(net: Any, path: Path, **options: Any) -> tuple[Any, ...]:
    """Export a network as its maker would; return the inputs of the trace."""
    inputs = (torch.randn(4, 34), torch.randn(4, 16))[: 1 + isinstance(net, Recurrent)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter's own parts
        torch.onnx.export(net, inputs, path, verbose=False, **options)
    return inputs


@pytest.mark.parametrize("name", NETWORKS)
def test_a_default_export_plays_as_its_network(name: str, tmp_path: Path) -> None:
    torch.manual_seed(0)
    net, path = NETWORKS[name]().eval(), tmp_path / "robot.onnx"
    batch = torch.export.Dim("batch")
    inputs = 1 + isinstance(net, Recurrent)
    obs, *carry = export(net, path, dynamic_shapes=({0: batch},) * inputs)
    assert path.with_suffix(".onnx.data").exists()
    roster = read_egos([str(path)], EMPTY, "scratch")
    [stack] = roster.policies  # a program, as a board plays it
    given = [jnp.asarray(value.numpy()) for value in carry]
    first = jnp.zeros(4, bool)
    policy = stack.spec.player()
    _, actions = policy.act(stack.row(0), *(given or [()]), jnp.asarray(obs.numpy()), first)
    with torch.no_grad():
        expected = net(obs, *carry)
    expected = expected[0] if carry else expected
    np.testing.assert_allclose(actions, expected.numpy(), atol=1e-5)


def test_fixed_batch_export_says_how_to_free_it(tmp_path: Path) -> None:
    export(layers(nn.Tanh()).eval(), tmp_path / "robot.onnx")
    with pytest.raises(EgoError, match=r"dynamic_shapes=\(\{0: 'batch'\},\)"):
        read_egos([str(tmp_path / "robot.onnx")], EMPTY, "scratch")


def test_an_export_in_one_file_is_one_file(tmp_path: Path) -> None:
    net, path = layers(nn.ReLU()).eval(), tmp_path / "robot.onnx"
    export(net, path, dynamic_shapes=({0: "batch"},), external_data=False)
    [member] = read_egos([str(path)], EMPTY, "scratch").members.values()
    assert [file for file, _ in member.files] == [path] and list(tmp_path.iterdir()) == [path]
