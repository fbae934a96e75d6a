"""A robot from an ONNX file, run by onnxruntime: any exporter's, recurrent or not."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 1024 * 1024 * 1024


class OnnxEgo:
    """A callable from observations [B, O] to actions [B, A].

    The model's first input is the observations and its first output the actions. A recurrent model
    has two or three
    inputs: observations, carry [B, H] and, if it wants to be told, a bool [B] that is true on an
        episode's first step;
    its second output is the next carry. This is what `assistax-zoo export --format onnx` writes.
    """

    def __init__(self, path: Path, reference: str) -> None:
        """Load the model.

        Raises:
            ValueError: onnxruntime is not installed, or the file is not a model of this form.
        """
        try:
            import onnxruntime
        except ImportError:
            raise ValueError(
                f"policy {reference!r} needs onnxruntime: pip install 'assistax-zoo[export]'"
            ) from None
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            raise ValueError(
                f"policy {reference!r}: no file of at most {MAX_BYTES} bytes there; give onnx:FILE"
            )
        data = path.read_bytes()
        self.digest = hashlib.sha256(data).hexdigest()
        onnxruntime.set_default_logger_severity(4)
        try:
            # From bytes: a model cannot name other files.
            self._session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
        except (
            Exception
        ) as error:  # onnxruntime has an exception class for each of its status codes
            message = " ".join(str(error).split())
            raise ValueError(
                f"policy {reference!r} is not an ONNX model that onnxruntime runs: {message[:300]}"
            ) from None
        self._inputs, self._outputs = self._session.get_inputs(), self._session.get_outputs()
        self._check_form(reference)
        self._carry: np.ndarray | None = None
        self._first = True

    def reset(self, rows: int) -> None:
        """Begin `rows` episodes."""
        self._first = True
        if self.recurrent:
            self._carry = np.zeros((rows, self._inputs[1].shape[1]), np.float32)

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return the actions for observations [B, O]."""
        width = self._inputs[0].shape[1]
        if isinstance(width, int) and width != obs.shape[1]:
            raise ValueError(
                f"the model reads {width} observations, the environment gives {obs.shape[1]}"
            )
        values: list[Any] = [obs.astype(np.float32, copy=False)]
        if self.recurrent:
            if self._carry is None:
                self.reset(len(obs))
            values += [self._carry, np.full(len(obs), self._first)]
        fed = {value.name: array for value, array in zip(self._inputs, values, strict=False)}
        answer: Any = self._session.run(
            [value.name for value in self._outputs[: 1 + self.recurrent]], fed
        )
        self._first = False
        if self.recurrent:
            self._carry = answer[1]
        return answer[0]

    @property
    def recurrent(self) -> bool:
        """Whether the model carries a state from step to step."""
        return len(self._inputs) > 1

    def _check_form(self, reference: str) -> None:
        inputs = [(value.type, len(value.shape)) for value in self._inputs]
        allowed = [("tensor(float)", 2), ("tensor(float)", 2), ("tensor(bool)", 1)]
        whole = (
            bool(inputs)
            and inputs == allowed[: len(inputs)]
            and len(self._outputs) >= 1 + (len(inputs) > 1)
        )
        if not whole or (len(inputs) > 1 and not isinstance(self._inputs[1].shape[1], int)):
            found = ", ".join(f"{value.name} {value.type}{value.shape}" for value in self._inputs)
            raise ValueError(
                f"policy {reference!r} has the inputs {found or 'none'}; expected float "
                "observations [N, O], or those with a float carry [N, H] and a bool first [N], and "
                "the next carry as second output"
            )
