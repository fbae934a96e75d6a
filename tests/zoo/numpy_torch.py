"""As much of `torch` and `safetensors.safe_open` in NumPy as docs/export.md uses."""

import contextlib
from collections.abc import Generator
from types import SimpleNamespace
from typing import Any

import numpy as np
import safetensors


class Tensor(np.ndarray):
    """An array with the methods of a tensor."""

    def clamp(self, low: float, high: float) -> Any:
        return np.clip(self, low, high)

    def tanh(self) -> Any:
        return np.tanh(self)


def tensor(value: Any) -> Tensor:
    return np.asarray(value, np.float32).view(Tensor)


class Module:
    def register_buffer(self, name: str, value: Tensor | None) -> None:
        setattr(self, name, value)

    def places(self) -> dict[str, Any]:
        """Return each tensor's owner and attribute by the tensor's name."""
        places: dict[str, Any] = {}
        for name, value in vars(self).items():
            if isinstance(value, Module):
                places |= {f"{name}.{inner}": place for inner, place in value.places().items()}
            elif isinstance(value, Tensor):
                places[name] = (self, name)
        return places

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        places = self.places()
        assert places.keys() == state.keys(), places.keys() ^ state.keys()
        for name, (owner, attribute) in places.items():
            assert getattr(owner, attribute).shape == state[name].shape, name
            setattr(owner, attribute, state[name])

    def __call__(self, *inputs: Any) -> Any:
        return self.forward(*inputs)

    def forward(self, *inputs: Any) -> Any:
        raise NotImplementedError


class Linear(Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        self.weight, self.bias = tensor(np.zeros((outputs, inputs))), tensor(np.zeros(outputs))

    def forward(self, *inputs: Any) -> Tensor:
        return inputs[0] @ self.weight.T + self.bias


class GRUCell(Module):
    """r, z, n with r * (W_hn h + b_hn), as torch has it."""

    def __init__(self, inputs: int, width: int) -> None:
        self.weight_ih, self.weight_hh = (
            tensor(np.zeros((3 * width, size))) for size in (inputs, width)
        )
        self.bias_ih, self.bias_hh = tensor(np.zeros(3 * width)), tensor(np.zeros(3 * width))

    def forward(self, *inputs: Any) -> Tensor:
        x, h = inputs
        h = tensor(np.zeros((len(x), self.weight_hh.shape[1]))) if h is None else h
        from_x = np.split(x @ self.weight_ih.T + self.bias_ih, 3, axis=1)
        from_h = np.split(h @ self.weight_hh.T + self.bias_hh, 3, axis=1)
        reset, update = (
            0.5 + 0.5 * np.tanh((a + b) / 2) for a, b in zip(from_x[:2], from_h[:2], strict=True)
        )
        new = np.tanh(from_x[2] + reset * from_h[2])
        return (1 - update) * new + update * h


class ModuleList(Module):
    def __init__(self, modules: Any) -> None:
        self.modules = list(modules)
        for index, module in enumerate(self.modules):
            setattr(self, str(index), module)

    def __iter__(self) -> Any:
        return iter(self.modules)


torch = SimpleNamespace(
    nn=SimpleNamespace(Module=Module, Linear=Linear, GRUCell=GRUCell, ModuleList=ModuleList),
    tanh=np.tanh,
    relu=lambda value: np.maximum(value, 0),
    no_grad=contextlib.nullcontext,
)


@contextlib.contextmanager
def safe_open(path: str, framework: str) -> Generator[Any]:
    """Open a file as `safetensors.safe_open` does for torch."""
    assert framework == "pt"
    with safetensors.safe_open(path, "np") as file:
        yield SimpleNamespace(
            metadata=file.metadata,
            keys=file.keys,
            get_tensor=lambda name: tensor(file.get_tensor(name)),
        )
