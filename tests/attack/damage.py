"""Damage to files: of bytes, and within the structure of JSON, safetensors and Parquet."""

import io
import json
import random
import struct
from collections.abc import Callable
from typing import Any

import polars as pl

Damage = Callable[[random.Random, bytes], bytes]
VALUES = (None, True, -1, 2**70, 1.5, 1e308, "", "x", "../../etc/passwd", "/etc/passwd")
VALUES += ("\x00\n", "\x1b]0;owned\x07", "<script>alert(1)</script>", [], {}, [[]], {"a": {}})
NAMES = ("x", "", "scratch/ippo-d1-s0-v0", "../a", "__proto__")


def flip(rng: random.Random, data: bytes) -> bytes:
    place = rng.randrange(len(data))
    return data[:place] + bytes([data[place] ^ (1 << rng.randrange(8))]) + data[place + 1 :]


def cut(rng: random.Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data))]


def grow(rng: random.Random, data: bytes) -> bytes:
    return data + rng.randbytes(rng.randrange(1, 40))


def splice(rng: random.Random, data: bytes) -> bytes:
    """Replace a stretch by random bytes, or by another stretch of the same file."""
    start, length = rng.randrange(len(data)), rng.randrange(1, 60)
    other = rng.randrange(len(data))
    patch = rng.randbytes(rng.randrange(9)) if rng.random() < 0.5 else data[other : other + length]
    return data[:start] + patch + data[start + length :]


def zero(rng: random.Random, data: bytes) -> bytes:
    start = rng.randrange(len(data))
    length = rng.randrange(1, 4096)
    return data[:start] + bytes(len(data[start : start + length])) + data[start + length :]


def digit(rng: random.Random, data: bytes) -> bytes:
    """Change a digit, which leaves JSON whole."""
    places = [index for index, byte in enumerate(data) if 48 <= byte <= 57]
    if not places:
        return flip(rng, data)
    place = rng.choice(places)
    return data[:place] + str(rng.randrange(10)).encode() + data[place + 1 :]


def change_value(rng: random.Random, content: Any) -> Any:
    """Change one value somewhere in a JSON value, or one key."""
    if not isinstance(content, dict | list) or not content:
        return rng.choice(VALUES)
    node, key = content, _any_key(rng, content)
    while isinstance(node[key], dict | list) and node[key] and rng.random() < 0.85:
        node = node[key]
        key = _any_key(rng, node)
    if isinstance(node, dict) and rng.random() < 0.2:
        node[rng.choice(NAMES)] = node.pop(key)
    elif isinstance(node, list) and rng.random() < 0.2:
        node.append(node[key])
    else:
        node[key] = rng.choice(VALUES)
    return content


def token(rng: random.Random, data: bytes) -> bytes:
    """Change a value or a key of JSON."""
    return json.dumps(change_value(rng, json.loads(data))).encode()


def tensors(rng: random.Random, data: bytes) -> bytes:
    """Change the header of a safetensors file, and keep its length right."""
    size = struct.unpack("<Q", data[:8])[0]
    header = json.dumps(change_value(rng, json.loads(data[8 : 8 + size]))).encode()
    lie = rng.choice((0, 0, 0, 1, -1, 2**63))
    return struct.pack("<Q", (len(header) + lie) % 2**64) + header + data[8 + size :]


def table(rng: random.Random, data: bytes) -> bytes:
    """Change a column of a Parquet table that stays readable: its values, its type, its name."""
    frame = pl.read_parquet(io.BytesIO(data))
    name = rng.choice(frame.columns)
    kind = rng.randrange(5)
    if kind == 0:
        frame = frame.drop(name)
    elif kind == 1:
        frame = frame.rename({name: rng.choice(("x", "../x", "<script>"))})
    elif kind == 2:
        frame = frame.with_columns(pl.lit(rng.choice((None, "x", -1, float("nan")))).alias(name))
    elif kind == 3:
        frame = frame.with_columns(frame[name].reverse().alias(name)).head(frame.height - 1)
    else:
        frame = pl.concat([frame, frame.head(1)])
    content = io.BytesIO()
    frame.write_parquet(content)
    return content.getvalue()


BYTES: tuple[Damage, ...] = (flip, cut, grow, splice, zero)
BY_KIND: dict[str, tuple[Damage, ...]] = {
    ".json": (*BYTES, digit, token, token, token),
    ".safetensors": (*BYTES, tensors, tensors),
    ".parquet": (*BYTES, table, table),
}


def damaged(rng: random.Random, data: bytes, ending: str) -> bytes:
    """Return a file's bytes with one damage that its kind allows."""
    return rng.choice(BY_KIND.get(ending, BYTES))(rng, data) if data else b"x"


def _any_key(rng: random.Random, node: Any) -> Any:
    return rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
