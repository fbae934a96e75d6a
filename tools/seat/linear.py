"""Rules of products, of systems of equations, and of the engine itself."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from tools.seat.emitter import Emitter, UnsupportedError, Value, text


def _dot(
    emitter: Emitter, given: list[Value], out: list[Any], *, dimension_numbers: Any, **_: Any
) -> Value:
    """Write a product: a loop for parameters in memory, else all its terms."""
    (left, right), ((over_left, over_right), (batch_left, batch_right)) = given, dimension_numbers
    if right.base is not None:
        return _by_parameters(emitter, left, right, out[0].shape, dimension_numbers)
    rows = _sides(left.elements, batch_left, over_left, last=True)  # [batch, free, over]
    columns = _sides(right.elements, batch_right, over_right, last=True)
    made = np.empty((rows.shape[0], rows.shape[1], columns.shape[1]), object)
    dtype = out[0].dtype.name
    for place in np.ndindex(made.shape):
        b, i, j = place
        pairs = zip(rows[b, i], columns[b, j], strict=True)
        terms = [f"{text(x, left.dtype)} * {text(y, right.dtype)}" for x, y in pairs]
        products = [emitter.scalar(dtype, term) for term in terms]
        made[place] = functools.reduce(lambda a, b: emitter.scalar(dtype, f"{a} + {b}"), products)
    return Value(made.reshape(out[0].shape), dtype)


def _sides(
    elements: np.ndarray, batch: tuple[int, ...], over: tuple[int, ...], *, last: bool
) -> np.ndarray:
    """Return elements as [batch, free, over]."""
    free = [axis for axis in range(elements.ndim) if axis not in (*batch, *over)]
    sizes = [int(np.prod([elements.shape[a] for a in axes])) for axes in (batch, free, over)]
    return elements.transpose([*batch, *free, *over]).reshape(sizes)


def _by_parameters(
    emitter: Emitter, left: Value, right: Value, shape: tuple[int, ...], numbers: Any
) -> Value:
    inner, outer = right.elements.shape
    if numbers != (((left.elements.ndim - 1,), (0,)), ((), ())) or left.elements.size != inner:
        raise UnsupportedError("parameters are multiplied otherwise than a row by a matrix")
    vector = emitter.array(Value(left.elements.ravel(), left.dtype))
    matrix = emitter.array(right)
    return emitter.result(
        "float32", shape, lambda name: f"product({name}, {vector}, {matrix}, {inner}, {outer})"
    )


def _lu(emitter: Emitter, given: list[Value], out: list[Any], **_: Any) -> list[Value]:
    """Factorise a matrix with pivots: the factors, the pivots and their permutation."""
    size = out[0].shape[0]
    matrix = emitter.array(given[0])
    pivots, order = emitter.fresh(), emitter.fresh()
    emitter.lines.append(f"int {pivots}[{size}], {order}[{size}];")
    factors = emitter.result(
        "float32",
        out[0].shape,
        lambda name: f"factorise<{size}>({name}, {pivots}, {order}, {matrix})",
    )
    rows = [
        Value(
            np.array([emitter.scalar("int32", f"{name}[{k}]") for k in range(size)], object),
            "int32",
        )
        for name in (pivots, order)
    ]
    return [factors, *rows]


def _solve(
    emitter: Emitter,
    given: list[Value],
    out: list[Any],
    *,
    const_lengths: Any,
    jaxprs: Any,
    **_: Any,
) -> list[Value]:
    begin = const_lengths.matvec + const_lengths.vecmat
    consts = given[begin : begin + const_lengths.solve]
    right = given[sum(const_lengths) :]
    return emitter.run(jaxprs.solve.jaxpr, jaxprs.solve.consts, [*consts, *right])


def _triangular(
    emitter: Emitter,
    given: list[Value],
    out: list[Any],
    *,
    left_side: bool,
    lower: bool,
    transpose_a: bool,
    unit_diagonal: bool,
    **_: Any,
) -> Value:
    if not left_side:
        raise UnsupportedError("triangular_solve from the right has no rule")
    matrix = given[0].elements.T if transpose_a else given[0].elements
    lower = lower != transpose_a
    size, columns = given[1].elements.shape
    made = np.empty((size, columns), object)

    def of(element: Any) -> str:
        return text(element, "float32")

    for column in range(columns):
        order = range(size) if lower else range(size - 1, -1, -1)
        for i in order:
            now = of(given[1].elements[i, column])
            for j in range(i) if lower else range(i + 1, size):
                term = f"{now} - {of(matrix[i, j])} * {made[j, column]}"
                now = emitter.scalar("float32", term)
            if not unit_diagonal:
                now = emitter.scalar("float32", f"{now} / {of(matrix[i, i])}")
            made[i, column] = now
    return Value(made, "float32")


def _engine(
    emitter: Emitter, given: list[Value], out: list[Any], *, attributes: Any, **_: Any
) -> list[Value]:
    """Call the fused engine for one simulation."""
    substeps = int(dict(attributes)["substeps"])
    names = [emitter.array(value) for value in given]
    results = [emitter.fresh() for _ in out]
    for name, shaped in zip(results, out, strict=True):
        emitter.lines.append(f"float {name}[{shaped.size}];")
    emitter.lines.append(f"advance({', '.join([*names, *results])}, {substeps});")
    values = []
    for name, shaped in zip(results, out, strict=True):
        elements = np.empty(shaped.size, object)
        for k in range(shaped.size):
            elements[k] = emitter.scalar("float32", f"{name}[{k}]")
        values.append(Value(elements.reshape(shaped.shape), "float32"))
    return values


LINEAR: dict[str, Callable[..., Any]] = {
    "dot_general": _dot,
    "lu": _lu,
    "custom_linear_solve": _solve,
    "triangular_solve": _triangular,
    "ffi_call": _engine,
}
