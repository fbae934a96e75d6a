"""Cost of a robot for one observation, counted from its program before it is compiled.

Every number that an operator writes costs about two nanoseconds of a core, whatever the operator:
the batch does not fit the cache, so that memory is what it waits for. A product within a matrix
multiplication costs much less. What depends on weights alone is computed once a step for all rows.
"""

import math
from typing import Any

NUMBER, PRODUCT = 2.0, 0.05  # nanoseconds, measured on two cores with 200 rows
ROWS = 200  # of a public job: observations that share what depends on weights alone
_FREE = ("reshape", "squeeze", "expand_dims")
# Most of one observation: 30 million products, or 750,000 numbers, which are 3 MB.
MOST = 1_500_000.0


def nanoseconds(policy: Any, params: Any, observation_size: int) -> float:
    """Return about how long one observation takes one core."""
    import jax
    import jax.numpy as jnp

    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), params)
    obs, first = jnp.zeros((1, observation_size)), jnp.ones(1, bool)
    traced = jax.make_jaxpr(policy.act)(shapes, policy.initial_carry((1,)), obs, first)
    weights = len(jax.tree.leaves(shapes))
    inputs = len(traced.jaxpr.invars)
    return _cost(traced.jaxpr, [place >= weights for place in range(inputs)])[0]


def _cost(jaxpr: Any, varies: list[bool]) -> tuple[float, list[bool]]:
    """Return the cost of a program, and which of its outputs depend on the observation."""
    varying = {var for var, does in zip(jaxpr.invars, varies, strict=True) if does}
    total = 0.0
    for equation in jaxpr.eqns:
        varies = [not hasattr(var, "val") and var in varying for var in equation.invars]
        cost, outputs = _equation(equation, varies)
        varying |= {var for var, does in zip(equation.outvars, outputs, strict=True) if does}
        total += cost if any(varies) else cost / ROWS
    return total, [not hasattr(var, "val") and var in varying for var in jaxpr.outvars]


def _equation(equation: Any, varies: list[bool]) -> tuple[float, list[bool]]:
    inner = [_plain(value) for value in equation.params.values() if _plain(value) is not None]
    fitting = [jaxpr for jaxpr in inner if len(jaxpr.invars) == len(varies)]
    if fitting:  # a function of JAX's own, such as a softmax; its weights' part is counted in full
        return max(_cost(jaxpr, varies) for jaxpr in fitting)
    if inner:
        return math.inf, [True] * len(equation.outvars)  # loops and branches: none is let in
    if equation.primitive.name in _FREE:
        return 0.0, [any(varies)] * len(equation.outvars)
    size = sum(math.prod(var.aval.shape) for var in equation.outvars)
    cost = NUMBER * max([size, *(math.prod(v.aval.shape) for v in equation.invars)])
    if equation.primitive.name == "dot_general":
        (contracted, _), _ = equation.params["dimension_numbers"]
        shape = equation.invars[0].aval.shape
        cost = NUMBER * size + PRODUCT * size * math.prod(shape[axis] for axis in contracted)
    return cost, [any(varies)] * len(equation.outvars)


def _plain(value: Any) -> Any:
    """Return the program in a parameter of an equation, if it is one."""
    value = getattr(value, "jaxpr", value)
    return value if hasattr(value, "eqns") else None
