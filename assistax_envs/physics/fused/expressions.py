"""Straight-line code: values that are computed once, in the order in which they were asked for.

The modules beside this one write rigid-body dynamics with `+`, `*` and the helpers below. What is
known when the program is generated (a mass, an axis) is a Python `float` and folds away: adding 0
and multiplying by 0 or 1 cost nothing. What is known only when the program runs (an angle) is a
`Value`: a name in a `Block` of statements, each of which is written once, however often it is
asked for.

A block can be printed as C++ (`Block.source`) or run with NumPy in double precision
(`Block.evaluate`), by which the tests hold each topic against MuJoCo without a compiler.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

NEGLIGIBLE = 1e-12  # a constant nearer than this to 0, 1 or -1 is taken for it


@dataclasses.dataclass(frozen=True)
class Operation:
    """What a statement does: as C++, where {0} is the first operand, and as a NumPy function."""

    text: str
    function: Callable[..., Any]


OPERATIONS: dict[str, Operation] = {
    "add": Operation("{0} + {1}", np.add),
    "subtract": Operation("{0} - {1}", np.subtract),
    "multiply": Operation("{0} * {1}", np.multiply),
    "negate": Operation("-{0}", np.negative),
    "multiply_add": Operation("{2} + {0} * {1}", lambda a, b, c: c + a * b),
    "multiply_subtract": Operation("{2} - {0} * {1}", lambda a, b, c: c - a * b),
    "minimum": Operation("minimum({0}, {1})", np.minimum),
    "maximum": Operation("maximum({0}, {1})", np.maximum),
    "reciprocal": Operation("1.0f / {0}", np.reciprocal),
}


@dataclasses.dataclass(frozen=True)
class Statement:
    """`name = operation(operands)`; operands are names or constants."""

    name: str
    operation: str
    operands: tuple[str | float, ...]


class Block:
    """Statements that each name one value; what is there already is not written again."""

    def __init__(self, prefix: str = "t") -> None:
        self.statements: list[Statement] = []
        self._prefix = prefix
        self._names: dict[tuple[str, tuple[str | float, ...]], str] = {}

    def input(self, name: str) -> "Value":
        """Return a value that the surrounding text provides under `name`, for example `q[3]`."""
        return Value(self, name)

    def apply(self, operation: str, *operands: "Scalar") -> "Value":
        """Return the value of an operation, from an earlier statement if there is one."""
        key = operation, tuple(x.name if isinstance(x, Value) else float(x) for x in operands)
        if key not in self._names:
            self._names[key] = f"{self._prefix}{len(self._names)}"
            self.statements.append(Statement(self._names[key], *key))
        return Value(self, self._names[key])

    def half_sincos(self, angle: "Value") -> tuple["Value", "Value"]:
        """Return sine and cosine of half of `angle`, which are the parts of a unit quaternion."""
        pair = self.apply("half_sincos", angle)
        return Value(self, f"{pair.name}.sine"), Value(self, f"{pair.name}.cosine")

    def source(self, first: int = 0) -> str:
        """Return the statements from number `first` on as C++."""
        return "\n".join(_source(statement) for statement in self.statements[first:])

    def evaluate(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Run all statements with NumPy and return every value by name; for tests."""
        values = dict(inputs)
        for name, operation, operands in map(dataclasses.astuple, self.statements):
            numbers = [values[x] if isinstance(x, str) else x for x in operands]
            if operation == "half_sincos":
                values[f"{name}.sine"] = np.sin(numbers[0] / 2)
                values[f"{name}.cosine"] = np.cos(numbers[0] / 2)
            else:
                values[name] = OPERATIONS[operation].function(*numbers)
        return values


class Value:
    """A number known only at run time; arithmetic with it writes statements in its block."""

    def __init__(self, block: Block, name: str) -> None:
        self.block, self.name = block, name

    def __repr__(self) -> str:
        return f"Value({self.name})"

    def __neg__(self) -> "Value":
        return self.block.apply("negate", self)

    def __add__(self, other: "Scalar") -> "Value":
        return self if is_constant(other, 0.0) else self.block.apply("add", self, other)

    __radd__ = __add__

    def __sub__(self, other: "Scalar") -> "Value":
        return self if is_constant(other, 0.0) else self.block.apply("subtract", self, other)

    def __rsub__(self, other: float) -> "Value":
        return -self if is_constant(other, 0.0) else self.block.apply("subtract", other, self)

    def __mul__(self, other: "Scalar") -> "Scalar":
        if is_constant(other, 0.0):
            return 0.0
        if is_constant(other, 1.0):
            return self
        return -self if is_constant(other, -1.0) else self.block.apply("multiply", self, other)

    __rmul__ = __mul__


Scalar: TypeAlias = Value | float
Vector: TypeAlias = Sequence[Scalar]
Matrix: TypeAlias = Sequence[Vector]  # of rows


def is_constant(x: Scalar, number: float) -> bool:
    """Return whether `x` is known to be `number` when the program is generated."""
    return not isinstance(x, Value) and bool(abs(x - number) < NEGLIGIBLE)


def multiply_add(a: Scalar, b: Scalar, c: Scalar) -> Scalar:
    """Return `c + a * b`: one statement where nothing folds."""
    trivial = any(is_constant(x, n) for x in (a, b) for n in (0.0, 1.0, -1.0))
    block = _block(a, b)
    if block is None or trivial or is_constant(c, 0.0):
        return a * b + c
    return block.apply("multiply_add", a, b, c)


def multiply_subtract(a: Scalar, b: Scalar, c: Scalar) -> Scalar:
    """Return `c - a * b`: one statement where nothing folds."""
    block = _block(a, b)
    if isinstance(a, Value) and isinstance(b, Value) and block and not is_constant(c, 0.0):
        return block.apply("multiply_subtract", a, b, c)
    return multiply_add(-a, b, c) if isinstance(b, Value) else multiply_add(a, -b, c)


def reciprocal(x: Scalar) -> Scalar:
    """Return 1 / x."""
    return x.block.apply("reciprocal", x) if isinstance(x, Value) else 1.0 / x


def minimum(a: Scalar, b: Scalar) -> Scalar:
    """Return the smaller number."""
    return _extremum("minimum", min, a, b)


def maximum(a: Scalar, b: Scalar) -> Scalar:
    """Return the larger number."""
    return _extremum("maximum", max, a, b)


def literal(x: float) -> str:
    """Return `x` rounded to single precision, as C++."""
    return f"{np.float32(x)!s}f"


def text(x: Scalar) -> str:
    """Return a run-time value's name, or a constant as a `real`."""
    return x.name if isinstance(x, Value) else f"splat({literal(x)})"


def _extremum(
    operation: str, fold: Callable[[float, float], float], a: Scalar, b: Scalar
) -> Scalar:
    if isinstance(a, Value):
        return a.block.apply(operation, a, b)
    if isinstance(b, Value):
        return b.block.apply(operation, b, a)  # C++ has it for a value and a constant in this order
    return fold(a, b)


def _block(*operands: Scalar) -> Block | None:
    return next((x.block for x in operands if isinstance(x, Value)), None)


def _source(statement: Statement) -> str:
    if statement.operation == "half_sincos":
        return f"SinCos {statement.name} = half_sincos({statement.operands[0]});"
    # Not `const`: nvcc's front end then takes minutes over some thousand statements.
    names = (x if isinstance(x, str) else literal(x) for x in statement.operands)
    return f"real {statement.name} = {OPERATIONS[statement.operation].text.format(*names)};"
