"""As much of `torch` and `safetensors.safe_open` in NumPy as docs/export.md uses."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import safetensors


class Tensor:
    def __init__(self, value: Any) -> None:
        self.value = np.asarray(value, np.float32)

    def __sub__(self, other: "Tensor") -> "Tensor":
        return Tensor(self.value - other.value)

    def __truediv__(self, other: "Tensor") -> "Tensor":
        return Tensor(self.value / other.value)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    def clamp(self, low: float, high: float) -> "Tensor":
        return Tensor(np.clip(self.value, low, high))

    def tanh(self) -> "Tensor":
        return Tensor(np.tanh(self.value))


class Module:
    def __init__(self) -> None:
        self._buffers: set[str] = set()

    def register_buffer(self, name: str, value: Tensor | None) -> None:
        setattr(self, name, value)
        self._buffers.add(name)

    def parameters_by_name(self) -> dict[str, Any]:
        functions: dict[str, Any] = {}
        for name, value in vars(self).items():
            if isinstance(value, Module):
                functions |= {
                    f"{name}.{inner}": place for inner, place in value.parameters_by_name().items()
                }
            elif isinstance(value, Tensor):
                functions[name] = (self, name)
        return functions

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        places = self.parameters_by_name()
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
        super().__init__()
        self.weight, self.bias = Tensor(np.zeros((outputs, inputs))), Tensor(np.zeros(outputs))

    def forward(self, *inputs: Any) -> Tensor:
        return Tensor(inputs[0].value @ self.weight.value.T + self.bias.value)


class GRUCell(Module):
    """r, z, n with r * (W_hn h + b_hn), as torch has it."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.weight_ih, self.bias_ih = (
            Tensor(np.zeros((3 * width, inputs))),
            Tensor(np.zeros(3 * width)),
        )
        self.weight_hh, self.bias_hh = (
            Tensor(np.zeros((3 * width, width))),
            Tensor(np.zeros(3 * width)),
        )

    def forward(self, *inputs: Any) -> Tensor:
        x, h = inputs[0].value, inputs[1]
        h = np.zeros((len(x), self.weight_hh.shape[1]), np.float32) if h is None else h.value
        from_x = np.split(x @ self.weight_ih.value.T + self.bias_ih.value, 3, axis=1)
        from_h = np.split(h @ self.weight_hh.value.T + self.bias_hh.value, 3, axis=1)
        reset, update = (
            0.5 + 0.5 * np.tanh((a + b) / 2) for a, b in zip(from_x[:2], from_h[:2], strict=True)
        )
        new = np.tanh(from_x[2] + reset * from_h[2])
        return Tensor((1 - update) * new + update * h)


class ModuleList(Module):
    def __init__(self, modules: Any) -> None:
        super().__init__()
        self.modules = list(modules)
        for index, module in enumerate(self.modules):
            setattr(self, str(index), module)

    def __iter__(self) -> Any:
        return iter(self.modules)


torch = SimpleNamespace(
    nn=SimpleNamespace(Module=Module, Linear=Linear, GRUCell=GRUCell, ModuleList=ModuleList),
    tanh=lambda tensor: tensor.tanh(),
    relu=lambda tensor: Tensor(np.maximum(tensor.value, 0)),
)


class safe_open:
    """`safetensors.safe_open` for this torch."""

    def __init__(self, path: str, framework: str) -> None:
        assert framework == "pt"
        self._file = safetensors.safe_open(path, "np")

    def __enter__(self) -> "safe_open":
        self._inner = self._file.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._file.__exit__(*error)

    def metadata(self) -> dict[str, str]:
        return self._inner.metadata()

    def keys(self) -> Any:
        return self._inner.keys()

    def get_tensor(self, name: str) -> Tensor:
        return Tensor(self._inner.get_tensor(name))
