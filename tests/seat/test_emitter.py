"""Each operation of JAX that the emitter writes gives JAX's numbers in a module."""

import json
import subprocess
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.seat.trajectories import NODE
from tests.system import needs
from tools.seat.build import FUNCTIONS, TYPES, compiled
from tools.seat.emitter import Layout, UnsupportedError, function
from tools.seat.golden import memory_of
from tools.seat.rules import RULES

X = jnp.linspace(-2.3, 3.1, 12, dtype=jnp.float32).reshape(3, 4)
K = jnp.array([2, 0, 5], jnp.int32)


def elementary(x: jax.Array, k: jax.Array) -> list[jax.Array]:
    y = jnp.abs(x) + 0.2
    curves = jnp.exp(x), jnp.log(y), jnp.sin(7.0 * x), jnp.cos(7.0 * x), jnp.tanh(x)
    roots = jnp.sqrt(y), jax.lax.rsqrt(y), jax.nn.sigmoid(x), jnp.log1p(y), y**1.7
    whole = jnp.floor(x), jnp.ceil(x), jnp.sign(x), jnp.square(x), x**3, jnp.clip(x, -1.0, 0.5)
    return [*curves, *roots, *whole, jnp.maximum(x, 0.1), x % 0.7, jnp.where(x > 0, x, -2.0 * x)]


def whole_numbers(x: jax.Array, k: jax.Array) -> list[jax.Array]:
    logic = (k > 1) & (k < 5), (k == 0) | (k > 4), ~(k > 1), k != 2
    return [k // 2, k % 3, jnp.maximum(k, 1), jnp.abs(-k), k * 0.16, *logic, x.astype(jnp.int32)]


def reductions(x: jax.Array, k: jax.Array) -> list[jax.Array]:
    sums = x.sum(), x.sum(0), x.mean(axis=1, keepdims=True), x.prod(1), x.max(0), x.min()
    places = x.argmax(1), x.argmin(0), (x > 0.0).any(1), (x > -9.0).all()
    return [*sums, *places, jnp.linalg.norm(x, axis=1)]


def moved(x: jax.Array, k: jax.Array) -> list[jax.Array]:
    joined = jnp.concatenate([x, x[:1]], axis=0), jnp.stack([x[0], x[1]]), jnp.column_stack([k, k])
    parts = (
        x.T,
        x[:, ::-1],
        x[1:, ::2],
        *jnp.split(x, 2, axis=1),
        jnp.broadcast_to(x[:, None], (3, 2, 4)),
    )
    written = x.at[1].set(0.5), x.at[:, jnp.array([0, 2])].add(1.0), x.at[k[0], k[1]].set(9.0)
    read = x[jnp.arange(3), k % 4], x[k[0]], jnp.array([1.0, 4.0, 9.0])[k % 3], jax.nn.one_hot(k, 6)
    return [*joined, *parts, *written, *read, jax.lax.dynamic_slice(x, (k[0] - 1, k[1]), (2, 2))]


def linear(x: jax.Array, k: jax.Array) -> list[jax.Array]:
    square = x[:, :3] @ x[:, :3].T + jnp.eye(3)
    swapped = square[::-1]  # needs other pivots
    solved = [jnp.linalg.solve(one, x) for one in (square, swapped)]
    return [*solved, jnp.einsum("ij,kj->ik", x, x), jnp.cross(x[:, :3], x[:, 1:])]


def controlled(x: jax.Array, k: jax.Array) -> list[jax.Array]:
    def step(total: jax.Array, row: jax.Array) -> tuple[jax.Array, jax.Array]:
        return total + row, total * row

    total, rows = jax.lax.scan(step, jnp.zeros(4), x)
    chosen = jax.lax.cond(k[0] > 1, lambda: x + 1.0, lambda: x - 1.0)
    known = jax.lax.cond(True, lambda: x, lambda: x * jax.random.normal(jax.random.key(0), ()))
    return [total, rows, chosen, known, jax.nn.relu(x)]


@needs("nodejs", NODE)
@pytest.mark.slow
@pytest.mark.parametrize(
    "traced", [elementary, whole_numbers, reductions, moved, linear, controlled]
)
def test_operations_are_jax_s(
    traced: Callable[[jax.Array, jax.Array], list[jax.Array]], tmp_path: Path
) -> None:
    pytest.importorskip("ziglang", reason="needs ziglang: pip install ziglang")
    layout = Layout()
    layout.add("x", X)
    layout.add("k", K)
    text = function("traced", layout, RULES, lambda x, k: (traced(x, k),), ("x", "k"), ("out",))
    runtime = resources.files("tools.seat").joinpath("runtime.h").read_text()
    whole = f"{TYPES}#define WORDS 8192\n{runtime}{text}"
    (tmp_path / "traced.wasm").write_bytes(compiled({"functions": (whole, FUNCTIONS)}))
    given = [str(word) for word in (*memory_of(X[None]), *memory_of(K[None]))]
    script = Path(__file__).with_name("operations.mjs")
    command = [str(NODE), str(script), str(tmp_path / "traced.wasm"), "traced", *given]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    words = np.array(json.loads(done.stdout), np.uint32)
    places = layout.trees["out"][0]
    for place, want in zip(places, traced(X, K), strict=True):
        found = words[place.offset : place.offset + place.size]
        kind = np.float32 if place.dtype == "float32" else np.int32
        np.testing.assert_allclose(
            found.view(kind).reshape(place.shape), np.asarray(want), rtol=2e-6, atol=2e-6
        )


def test_an_operation_without_a_rule_is_named() -> None:
    def traced(x: jax.Array) -> tuple[Any, ...]:
        return (jnp.sort(x),)

    layout = Layout()
    layout.add("x", X)
    with pytest.raises(UnsupportedError, match="the operation sort has no rule; add it to tools"):
        function("traced", layout, RULES, traced, ("x",), ("out",))


def test_equal_expressions_are_written_once() -> None:
    layout = Layout()
    layout.add("x", X[0])
    text = function(
        "traced", layout, RULES, lambda x: (jnp.exp(x) + 2.0 * jnp.exp(x),), ("x",), ("out",)
    )
    assert text.count("exp_of(") == 4
