"""Rules of operations that move elements about; known places cost no code."""

import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from tools.seat.emitter import Emitter, Sizes, Value, text


def _moved(move: Callable[..., np.ndarray]) -> Callable[..., Value]:
    def rule(emitter: Emitter, given: list[Value], out: list[Any], **params: Any) -> Value:
        return Value(move(given[0].elements, out[0].shape, **params), given[0].dtype)

    return rule


def _reshape(elements: np.ndarray, to: Sizes, **_: Any) -> np.ndarray:
    return elements.reshape(to)


def _broadcast(
    elements: np.ndarray,
    to: Sizes,
    *,
    broadcast_dimensions: Sizes,
    **_: Any,
) -> np.ndarray:
    wide = [1] * len(to)
    for axis, size in zip(broadcast_dimensions, elements.shape, strict=True):
        wide[int(axis)] = size
    return np.broadcast_to(elements.reshape(wide), to)


def _transpose(elements: np.ndarray, to: Sizes, *, permutation: Sizes, **_: Any) -> np.ndarray:
    return elements.transpose(permutation)


def _slice(
    elements: np.ndarray,
    to: Sizes,
    *,
    start_indices: Sizes,
    limit_indices: Sizes,
    strides: Sizes | None,
    **_: Any,
) -> np.ndarray:
    steps = strides or (1,) * elements.ndim
    return elements[tuple(map(slice, start_indices, limit_indices, steps))]


def _rev(elements: np.ndarray, to: Sizes, *, dimensions: Sizes, **_: Any) -> np.ndarray:
    return np.flip(elements, dimensions)


def _concatenate(
    emitter: Emitter, given: list[Value], out: list[Any], *, dimension: int, **_: Any
) -> Value:
    joined = np.concatenate([value.elements for value in given], axis=dimension)
    return Value(joined, given[0].dtype)


def _stack(emitter: Emitter, given: list[Value], out: list[Any], *, axis: int, **_: Any) -> Value:
    return Value(np.stack([value.elements for value in given], axis=axis), given[0].dtype)


def _split(
    emitter: Emitter,
    given: list[Value],
    out: list[Any],
    *,
    sizes: Sizes,
    axis: int,
    **_: Any,
) -> list[Value]:
    cuts = list(itertools.accumulate(sizes))[:-1]
    return [Value(part, given[0].dtype) for part in np.split(given[0].elements, cuts, axis)]


class _Axes(NamedTuple):
    """Axes of a gather or a scatter, which name them differently."""

    windows: Sizes  # of the slices or updates: those within a window
    dropped: Sizes  # of the operand: those that a window lacks
    batches: Sizes  # of the indices: those that go with the operand's batches


def _places(
    shape: Sizes, rank: int, batching: Sizes, axes: _Axes
) -> Iterator[tuple[tuple[int, ...], tuple[int, ...], list[Any]]]:
    """Yield each place of the slices or updates, its row of indices, and its place in a window.

    Args:
        shape: Shape of the slices or updates.
        rank: Number of the operand's axes.
        batching: The operand's batch axes.
        axes: The other axes.
    """
    windows = [axis for axis in range(rank) if axis not in (*axes.dropped, *batching)]
    batch = [axis for axis in range(len(shape)) if axis not in axes.windows]
    for place in np.ndindex(*shape):
        row = tuple(place[axis] for axis in batch)
        at: list[Any] = [0] * rank
        for axis, of_row in zip(batching, axes.batches, strict=True):
            at[axis] = row[of_row]
        for axis, of_place in zip(windows, axes.windows, strict=True):
            at[axis] = place[of_place]
        yield place, row, at


def _gather(
    emitter: Emitter,
    given: list[Value],
    out: list[Any],
    *,
    dimension_numbers: Any,
    slice_sizes: Sizes,
    **_: Any,
) -> Value:
    """Read slices of an array; places beyond it are taken as its ends."""
    (operand, starts), d = given, dimension_numbers
    shape, made = operand.elements.shape, np.empty(out[0].shape, object)
    axes = _Axes(d.offset_dims, d.collapsed_slice_dims, d.start_indices_batching_dims)
    for place, row, at in _places(made.shape, len(shape), d.operand_batching_dims, axes):
        begins = {
            int(axis): (starts.elements[(*row, k)], shape[axis] - slice_sizes[axis])
            for k, axis in enumerate(d.start_index_map)
        }
        made[place] = _element(emitter, operand, at, begins)
    return Value(made, operand.dtype)


def _element(
    emitter: Emitter, operand: Value, at: list[int], begins: dict[int, tuple[Any, int]]
) -> Any:
    """Return an element whose place may be known only when the code runs."""
    unknown = {axis: pair for axis, pair in begins.items() if isinstance(pair[0], str)}
    for axis, (start, most) in begins.items():
        if axis not in unknown:
            at[axis] += int(np.clip(start, 0, most))
    if not unknown:
        return operand.elements[tuple(at)]
    # Along the unknown axes alone, from this element on.
    cut = tuple(
        slice(at[axis], at[axis] + unknown[axis][1] + 1) if axis in unknown else at[axis]
        for axis in range(len(at))
    )
    part = operand.elements[cut]
    strides = np.cumprod([1, *part.shape[:0:-1]])[::-1]
    terms = [
        f"within({start}, {most}) * {stride}"
        for (_, (start, most)), stride in zip(sorted(unknown.items()), strides, strict=True)
    ]
    array = emitter.array(Value(part, operand.dtype))
    return emitter.scalar(operand.dtype, f"{array}[{' + '.join(terms)}]")


def _scatter(add: bool) -> Callable[..., Value]:
    def rule(
        emitter: Emitter,
        given: list[Value],
        out: list[Any],
        *,
        dimension_numbers: Any,
        **_: Any,
    ) -> Value:
        operand, starts, updates = given
        made = operand.elements.copy()
        for at, update in _updates(dimension_numbers, made.shape, starts, updates):
            _write(emitter, Value(made, operand.dtype), at, update, add)
        return Value(made, operand.dtype)

    return rule


def _updates(
    d: Any, shape: Sizes, starts: Value, updates: Value
) -> Iterator[tuple[list[Any], Any]]:
    """Yield the place of each update, a number or a text for each axis, and the update."""
    axes = _Axes(d.update_window_dims, d.inserted_window_dims, d.scatter_indices_batching_dims)
    for place, row, at in _places(
        updates.elements.shape, len(shape), d.operand_batching_dims, axes
    ):
        for k, axis in enumerate(d.scatter_dims_to_operand_dims):
            start = starts.elements[(*row, k)]
            at[axis] = f"{start} + {at[axis]}" if isinstance(start, str) else at[axis] + int(start)
        yield at, updates.elements[place]


def _write(emitter: Emitter, into: Value, at: list[Any], update: Any, add: bool) -> None:
    """Put an update into the elements; places beyond them are left out."""
    elements, dtype = into.elements, into.dtype
    for place in np.ndindex(elements.shape):
        pairs = list(zip(at, place, strict=True))
        if any(not isinstance(where, str) and where != axis for where, axis in pairs):
            continue
        old, new = text(elements[place], dtype), text(update, dtype)
        new = emitter.scalar(dtype, f"{old} + {new}") if add else new
        tests = [f"{where} == {axis}" for where, axis in pairs if isinstance(where, str)]
        known = emitter.scalar(dtype, f"({' && '.join(tests)}) ? {new} : {old}") if tests else None
        elements[place] = known or (new if add or isinstance(update, str) else update)


def _dynamic_slice(
    emitter: Emitter, given: list[Value], out: list[Any], *, slice_sizes: Sizes, **_: Any
) -> Value:
    operand, *starts = given
    made = np.empty(slice_sizes, object)
    shape = operand.elements.shape
    begins = {
        axis: (start.elements[()], shape[axis] - slice_sizes[axis])
        for axis, start in enumerate(starts)
    }
    for place in np.ndindex(*slice_sizes):
        made[place] = _element(emitter, operand, list(place), begins)
    return Value(made, operand.dtype)


INDEXING: dict[str, Callable[..., Any]] = {
    "reshape": _moved(_reshape),
    "squeeze": _moved(_reshape),
    "expand_dims": _moved(_reshape),
    "broadcast_in_dim": _moved(_broadcast),
    "transpose": _moved(_transpose),
    "slice": _moved(_slice),
    "rev": _moved(_rev),
    "concatenate": _concatenate,
    "stack": _stack,
    "split": _split,
    "gather": _gather,
    "scatter": _scatter(add=False),
    "scatter-add": _scatter(add=True),
    "dynamic_slice": _dynamic_slice,
}
