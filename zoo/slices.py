"""Single policies cut out of a remote's shard by byte ranges, without fetching the rest."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from zoo.cache import cached_row, refuse_write
from zoo.errors import IntegrityError
from zoo.files import atomic_write
from zoo.remotes import Remote, TransientError, with_retries
from zoo.schema import PolicyEntry, Shard
from zoo.tensors import DTYPES, MAX_HEADER_BYTES, Leaves, encode, row_sha256

REQUEST_BYTES = 64 * 1024  # what a request costs, in bytes of a shard
FIRST_BYTES = 64 * 1024  # most headers are shorter


class NoRangesError(Exception):
    """The remote sends whole files only."""


def fetch_rows(
    remote: Remote,
    path: str,
    shard: Shard,
    entries: Sequence[PolicyEntry],
    advance: Callable[[int], None] = lambda count: None,
) -> int | None:
    """Fetch some policies of a shard into the cache and return the bytes that came; None if it is no gain.

    Raises:
        NoRangesError: The remote sends whole files only.
        RemoteError: The remote does not have the shard, or fails again and again.
        IntegrityError: The remote's bytes are not those of the registry.
        CacheError: The cache cannot take them.
    """
    if len(entries) * shard.bytes // shard.rows + REQUEST_BYTES > shard.bytes // 2:
        return None
    source = f"{path} of {remote.name}"
    head = _read(remote, path, 0, min(FIRST_BYTES, shard.bytes))
    base = 8 + int.from_bytes(head[:8], "little")
    if base > min(MAX_HEADER_BYTES, shard.bytes):
        raise _damage(source, f"a header within {shard.bytes} bytes", f"one of {base}")
    if base > len(head):
        head += _read(remote, path, len(head), base)
    layout = _layout(head[8:base], shard, base, source)
    spans = _spans(sorted(entry.row for entry in entries))
    if sum(size for _, _, size in layout.values()) * len(entries) + len(layout) * len(
        spans
    ) * REQUEST_BYTES > (shard.bytes // 2):
        return None
    rows: dict[int, Leaves] = {entry.row: {} for entry in entries}
    received = len(head)
    for name, (form, begin, size) in layout.items():
        for first, last in spans:
            data = _read(remote, path, begin + first * size, begin + last * size)
            received += len(data)
            advance(len(data))
            block = np.frombuffer(data, form[0]).reshape(last - first, *form[1])
            for row in range(first, last):
                rows[row][name] = block[row - first]
    for entry in entries:
        _keep(entry, rows[entry.row], source)
    return received


def _keep(entry: PolicyEntry, leaves: Leaves, source: str) -> None:
    found = row_sha256(leaves)
    if found != entry.sha256:
        raise _damage(f"{entry.id} in {source}", f"sha256 {entry.sha256}", f"sha256 {found}")
    stacked = {name: value[None] for name, value in sorted(leaves.items())}
    data = encode(
        stacked, {"spec": entry.spec.to_json(), "rows": [{"id": entry.id, "sha256": entry.sha256}]}
    )
    target = cached_row(entry.sha256)
    try:
        atomic_write(target, data)
    except OSError as error:
        refuse_write(error, target, len(data))


def _read(remote: Remote, path: str, start: int, stop: int) -> bytes:
    """Return exactly the bytes from `start` to `stop`."""

    def read() -> bytes:
        data = bytearray()
        with remote.open(path, start, stop) as stream:
            if stream.start != start:
                raise NoRangesError
            for chunk in stream.chunks:
                data += chunk
                if len(data) > stop - start:
                    raise NoRangesError
        if len(data) < stop - start:
            raise TransientError(f"the end after {len(data)} of {stop - start} bytes")
        return bytes(data)

    return with_retries(read, f"{path} of {remote.name}")


def _layout(header: bytes, shard: Shard, base: int, source: str) -> dict[str, tuple[Any, int, int]]:
    """Return (dtype and shape of a row, where row 0 begins in the file, bytes of a row) of each leaf."""
    try:
        tensors: Mapping[str, Any] = json.loads(header)
        return {
            name: _leaf(leaf, shard, base)
            for name, leaf in tensors.items()
            if name != "__metadata__"
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise _damage(
            source,
            f"a safetensors header with {shard.rows} rows",
            f"{type(error).__name__}: {error}",
        ) from None


def _leaf(leaf: Mapping[str, Any], shard: Shard, base: int) -> tuple[Any, int, int]:
    dtype, (rows, *shape), (begin, end) = DTYPES[leaf["dtype"]], leaf["shape"], leaf["data_offsets"]
    if not all(type(number) is int and number >= 0 for number in (rows, begin, end, *shape)):
        raise ValueError("sizes are whole numbers")
    size = dtype.itemsize * int(np.prod(shape, dtype=object))
    if rows != shard.rows or end - begin != rows * size or base + end > shard.bytes:
        raise ValueError("sizes do not fit the shard")
    return (dtype, shape), base + begin, size


def _spans(rows: Sequence[int]) -> list[tuple[int, int]]:
    """Return neighbouring rows joined: [2, 3, 7] gives [(2, 4), (7, 8)]."""
    spans: list[tuple[int, int]] = []
    for row in rows:
        if spans and spans[-1][1] == row:
            spans[-1] = spans[-1][0], row + 1
        else:
            spans.append((row, row + 1))
    return spans


def _damage(source: str, expected: str, found: str) -> IntegrityError:
    return IntegrityError(
        source,
        expected=expected,
        found=found,
        done="nothing was added; the bytes were thrown away",
        next_step="fetch from another remote, and tell the owner of this one",
    )
