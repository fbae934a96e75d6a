"""Rules of arithmetic: what each operation of JAX is in C++, element by element."""

import functools
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from tools.seat.emitter import Emitter, Sizes, UnsupportedError, Value, text
from tools.seat.indexing import INDEXING
from tools.seat.linear import LINEAR

UNARY = {
    "neg": "-{0}",
    "not": "!{0}",
    "sqrt": "__builtin_sqrtf({0})",
    "rsqrt": "1.0f / __builtin_sqrtf({0})",
    "floor": "__builtin_floorf({0})",
    "ceil": "__builtin_ceilf({0})",
    "sign": "sign_of({0})",
    "exp": "exp_of({0})",
    "log": "log_of({0})",
    "log1p": "log1p_of({0})",
    "sin": "sin_of({0})",
    "cos": "cos_of({0})",
    "tanh": "tanh_of({0})",
    "logistic": "logistic_of({0})",
    "square": "{0} * {0}",
}
BINARY = {
    "add": "{0} + {1}",
    "add_any": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "eq": "{0} == {1}",
    "ne": "{0} != {1}",
    "lt": "{0} < {1}",
    "le": "{0} <= {1}",
    "gt": "{0} > {1}",
    "ge": "{0} >= {1}",
    "and": "{0} & {1}",
    "or": "{0} | {1}",
    "xor": "{0} ^ {1}",
    "atan2": "atan2_of({0}, {1})",
    "pow": "pow_of({0}, {1})",
}
# Those that are written otherwise for whole numbers.
OF_KIND = {
    "max": ("__builtin_wasm_max_f32({0}, {1})", "({0} > {1} ? {0} : {1})"),
    "min": ("__builtin_wasm_min_f32({0}, {1})", "({0} < {1} ? {0} : {1})"),
    "div": ("{0} / {1}", "({1} == 0 ? -1 : {0} / {1})"),
    "rem": ("rem_of({0}, {1})", "({1} == 0 ? {0} : {0} % {1})"),
    "abs": ("__builtin_fabsf({0})", "({0} < 0 ? -{0} : {0})"),
}
REDUCED = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_or": "or",
    "reduce_and": "and",
}


def elementwise(emitter: Emitter, template: str, given: list[Value], dtype: str) -> Value:
    """Return a template's value for the elements of values of one shape, or of no shape."""
    shape = np.broadcast_shapes(*(value.elements.shape for value in given))
    lists = [np.broadcast_to(value.elements, shape).ravel() for value in given]
    made = np.empty(len(lists[0]), object)
    for k, elements in enumerate(zip(*lists, strict=True)):
        texts = [text(one, value.dtype) for one, value in zip(elements, given, strict=True)]
        made[k] = emitter.scalar(dtype, template.format(*texts))
    return Value(made.reshape(shape), dtype)


def _template(name: str, dtype: str) -> str:
    if name in OF_KIND:
        return OF_KIND[name][dtype != "float32"]
    return {**UNARY, **BINARY}[name]


def _plain(name: str) -> Callable[..., Value]:
    def rule(emitter: Emitter, given: list[Value], out: list[Any], **_: Any) -> Value:
        return elementwise(emitter, _template(name, given[0].dtype), given, out[0].dtype.name)

    return rule


def _select(emitter: Emitter, given: list[Value], out: list[Any], **_: Any) -> Value:
    which, *cases = given
    if len(cases) != 2:
        raise UnsupportedError(f"select_n has {len(cases)} cases; the emitter knows two")
    if which.known:
        where = np.broadcast_to(which.numbers().astype(bool), cases[0].elements.shape)
        chosen = np.where(where, cases[1].elements, cases[0].elements)
        return Value(chosen.astype(object), cases[0].dtype)
    return elementwise(emitter, "({0} ? {2} : {1})", given, cases[0].dtype)


def _clamp(emitter: Emitter, given: list[Value], out: list[Any], **_: Any) -> Value:
    low, value, high = given
    least = elementwise(emitter, _template("max", value.dtype), [value, low], value.dtype)
    return elementwise(emitter, _template("min", value.dtype), [least, high], value.dtype)


def _convert(emitter: Emitter, given: list[Value], out: list[Any], **_: Any) -> Value:
    (value,), dtype = given, out[0].dtype.name
    if dtype == value.dtype:
        return value
    kinds = {"float32": "(float){0}", "int32": "(int){0}", "uint32": "(unsigned){0}"}
    return elementwise(emitter, {**kinds, "bool": "{0} != 0"}[dtype], given, dtype)


def _integer_pow(
    emitter: Emitter, given: list[Value], out: list[Any], *, y: int, **_: Any
) -> Value:
    if not 2 <= y <= 4:
        raise UnsupportedError(f"integer_pow has the exponent {y}; the emitter knows 2, 3 and 4")
    square = elementwise(emitter, "{0} * {0}", given, given[0].dtype)
    if y == 2:
        return square
    other = [square, square] if y == 4 else [square, given[0]]
    return elementwise(emitter, "{0} * {1}", other, given[0].dtype)


def _reduce(name: str) -> Callable[..., Value]:
    def rule(
        emitter: Emitter, given: list[Value], out: list[Any], *, axes: Sizes, **_: Any
    ) -> Value:
        elements, dtype = given[0].elements, given[0].dtype
        kept = [axis for axis in range(elements.ndim) if axis not in axes]
        rows = np.transpose(elements, [*kept, *axes]).reshape(out[0].size, -1)
        parts = [Value(column, dtype) for column in rows.T]
        template = _template(REDUCED[name], dtype)
        total = functools.reduce(lambda a, b: elementwise(emitter, template, [a, b], dtype), parts)
        return Value(total.elements.reshape(out[0].shape), dtype)

    return rule


def _arg(sign: str) -> Callable[..., Value]:
    def rule(
        emitter: Emitter, given: list[Value], out: list[Any], *, axes: Sizes, **_: Any
    ) -> Value:
        rows = np.moveaxis(given[0].elements, axes[0], 0)
        made = np.empty(out[0].shape, object)
        for place in np.ndindex(made.shape):
            best, which = rows[(0, *place)], "0"
            for k in range(1, rows.shape[0]):
                now = rows[(k, *place)]
                texts = text(now, given[0].dtype), text(best, given[0].dtype)
                better = emitter.scalar("bool", f"{texts[0]} {sign} {texts[1]}")
                best = emitter.scalar(given[0].dtype, f"{better} ? {texts[0]} : {texts[1]}")
                which = emitter.scalar("int32", f"{better} ? {k} : {which}")
            made[place] = which
        return Value(made, out[0].dtype.name)

    return rule


def _inlined(emitter: Emitter, given: list[Value], out: list[Any], **params: Any) -> list[Value]:
    closed: Any = params["jaxpr"] if "jaxpr" in params else params["call_jaxpr"]
    return emitter.run(closed.jaxpr, closed.consts, given)


def _cond(
    emitter: Emitter, given: list[Value], out: list[Any], *, branches: Any, **_: Any
) -> list[Value]:
    which, *arguments = given
    if which.known:
        chosen = branches[int(np.clip(which.numbers(), 0, len(branches) - 1))]
        return emitter.run(chosen.jaxpr, chosen.consts, arguments)
    both = [emitter.run(one.jaxpr, one.consts, arguments) for one in branches]
    where = elementwise(emitter, "{0} > 0", [which], "bool")
    pairs = zip(*both, strict=True)
    return [_select(emitter, [where, off, on], out) for off, on in pairs]


def _scan(
    emitter: Emitter,
    given: list[Value],
    out: list[Any],
    *,
    jaxpr: Any,
    length: int,
    num_consts: int,
    num_carry: int,
    reverse: bool,
    **_: Any,
) -> list[Value]:
    """Write a scan step by step."""
    consts, carry = given[:num_consts], given[num_consts : num_consts + num_carry]
    inputs, rows = given[num_consts + num_carry :], []
    for step in reversed(range(length)) if reverse else range(length):
        now = [Value(value.elements[step], value.dtype) for value in inputs]
        made = emitter.run(jaxpr.jaxpr, jaxpr.consts, [*consts, *carry, *now])
        carry, row = made[:num_carry], made[num_carry:]
        rows.append(row)
    rows = rows[::-1] if reverse else rows
    stacked = [
        Value(np.stack([one.elements for one in column]), column[0].dtype)
        for column in zip(*rows, strict=True)
    ]
    return [*carry, *stacked]


def _same(emitter: Emitter, given: list[Value], out: list[Any], **_: Any) -> list[Value]:
    return given


def _finite(emitter: Emitter, given: list[Value], out: list[Any], **_: Any) -> Value:
    return elementwise(emitter, "__builtin_isfinite({0})", given, "bool")


RULES: dict[str, Callable[..., Any]] = {
    **{name: _plain(name) for name in itertools.chain(UNARY, BINARY, OF_KIND)},
    **{name: _reduce(name) for name in REDUCED},
    "argmax": _arg(">"),
    "argmin": _arg("<"),
    "select_n": _select,
    "clamp": _clamp,
    "convert_element_type": _convert,
    "integer_pow": _integer_pow,
    "is_finite": _finite,
    "jit": _inlined,
    "closed_call": _inlined,
    "custom_jvp_call": _inlined,
    "custom_vjp_call": _inlined,
    "cond": _cond,
    "scan": _scan,
    "stop_gradient": _same,
    "copy": _same,
    **INDEXING,
    **LINEAR,
}
