"""From what JAX traces to straight-line C++: every element of an array is a scalar of its own.

Arrays of a task are small, so moving their elements about costs no code at all, and the compiler
sees plain arithmetic. Products with large parameters alone are loops. All memory of a module is
one array `M` of four-byte words; `Layout` gives names to its parts.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

TYPES = {"float32": "float", "int32": "int", "uint32": "unsigned", "bool": "bool"}
FIELDS = {"float32": "f", "int32": "i", "uint32": "u", "bool": "i"}
Sizes = tuple[Any, ...]  # of whole numbers, as JAX gives them: Python's and NumPy's
LOOPED = 512  # elements of an argument, from which on it stays in memory


class UnsupportedError(ValueError):
    """The traced function has an operation that cannot be written as C++."""


@dataclasses.dataclass(frozen=True)
class Value:
    """An array: names of scalars or numbers, in the array's shape."""

    elements: np.ndarray  # of str and NumPy scalars, dtype object
    dtype: str
    base: int | None = None  # place in `M` of an argument that stays in memory

    @property
    def known(self) -> bool:
        """Whether all elements are numbers."""
        return not any(isinstance(one, str) for one in self.elements.flat)

    def numbers(self) -> np.ndarray:
        """Return the numbers of a known value."""
        return self.elements.astype(self.dtype)


def constant(array: Any) -> Value:
    """Return the value of a NumPy or JAX array; keys are unknown, since nothing may draw."""
    if jax.dtypes.issubdtype(array.dtype if hasattr(array, "dtype") else int, jax.dtypes.prng_key):
        return Value(np.full(array.shape, "key", object), "key")
    known = np.asarray(array)
    if known.dtype.name not in TYPES:
        raise UnsupportedError(f"a constant is {known.dtype.name}; allowed are {', '.join(TYPES)}")
    elements = np.empty(known.shape, object)
    for place in np.ndindex(known.shape):
        elements[place] = known[place]
    return Value(elements, known.dtype.name)


@dataclasses.dataclass(frozen=True)
class Place:
    """A leaf of a named tree in a module's memory."""

    name: str
    offset: int  # words
    shape: tuple[int, ...]
    dtype: str

    @property
    def size(self) -> int:
        """Number of words."""
        return math.prod(self.shape)


class Layout:
    """Parts of a module's memory: named trees of arrays."""

    def __init__(self) -> None:
        self.words = 0
        self.trees: dict[str, tuple[list[Place], Any]] = {}

    def add(self, name: str, tree: Any) -> None:
        """Give places to the leaves of a tree of arrays or shapes."""
        leaves, structure = jax.tree_util.tree_flatten_with_path(tree)
        places = []
        for path, leaf in leaves:
            places.append(
                Place(jax.tree_util.keystr(path), self.words, leaf.shape, np.dtype(leaf.dtype).name)
            )
            self.words += places[-1].size
        self.trees[name] = places, structure

    def shapes(self, name: str) -> Any:
        """Return the tree as shapes."""
        places, structure = self.trees[name]
        leaves = [jax.ShapeDtypeStruct(place.shape, place.dtype) for place in places]
        return jax.tree_util.tree_unflatten(structure, leaves)

    def content(self) -> dict[str, Any]:
        """Return the layout as JSON-ready values: name -> leaf -> [offset, size, type]."""
        return {
            name: {place.name: [place.offset, place.size, FIELDS[place.dtype]] for place in places}
            for name, (places, _) in self.trees.items()
        }


class Emitter:
    """Writes one traced function as a C++ function without arguments, from `M` to `M`."""

    def __init__(self, rules: dict[str, Callable[..., Any]]) -> None:
        self.lines: list[str] = []
        self._rules = rules
        self._names: dict[tuple[str, str], str] = {}
        self._count = 0

    def fresh(self) -> str:
        """Return a new name."""
        self._count += 1
        return f"t{self._count}"

    def scalar(self, dtype: str, expression: str) -> str:
        """Return the name of an expression's value; equal expressions have one name."""
        key = dtype, expression
        if key not in self._names:
            name = self._names[key] = self.fresh()
            self.lines.append(f"const {TYPES[dtype]} {name} = {expression};")
        return self._names[key]

    def array(self, value: Value) -> str:
        """Return the name of a C++ array that holds a value's elements."""
        if value.base is not None:
            return f"&M[{value.base}].f"
        texts = ", ".join(text(one, value.dtype) for one in value.elements.flat)
        key = f"{value.dtype}[]", texts
        if key not in self._names:
            name = self._names[key] = self.fresh()
            kind = "static const" if value.known else ""
            self.lines.append(f"{kind} {TYPES[value.dtype]} {name}[] = {{{texts}}};")
        return self._names[key]

    def result(self, dtype: str, shape: tuple[int, ...], call: Callable[[str], str]) -> Value:
        """Return what a C++ call writes into a new array, whose name `call` takes."""
        name = self.fresh()
        self.lines.append(f"{TYPES[dtype]} {name}[{math.prod(shape)}];")
        self.lines.append(f"{call(name)};")
        elements = np.empty(math.prod(shape), object)
        for k in range(elements.size):
            elements[k] = self.scalar(dtype, f"{name}[{k}]")
        return Value(elements.reshape(shape), dtype)

    def run(self, jaxpr: Any, consts: Sequence[Any], values: Sequence[Value]) -> list[Value]:
        """Return the outputs of a jaxpr for values of its arguments."""
        known: dict[Any, Value] = {}
        known |= zip(jaxpr.constvars, map(constant, consts), strict=True)
        known |= zip(jaxpr.invars, values, strict=True)

        def read(atom: Any) -> Value:
            if isinstance(atom, core.Literal):
                return constant(np.asarray(atom.val, atom.aval.dtype))
            return known[atom]

        for equation in _needed(jaxpr):
            given = [read(atom) for atom in equation.invars]
            found = self._apply(equation, given)
            known |= zip(equation.outvars, found, strict=True)
        return [read(atom) for atom in jaxpr.outvars]

    def _apply(self, equation: Any, given: list[Value]) -> list[Value]:
        name = equation.primitive.name
        out = [variable.aval for variable in equation.outvars]
        if all(value.known for value in given) and name not in _INLINED:
            return _folded(equation, given)
        if name not in self._rules:
            raise UnsupportedError(f"the operation {name} has no rule; add it to tools/seat/rules")
        made = self._rules[name](self, given, out, **equation.params)
        return made if isinstance(made, list) else [made]


_INLINED = ("jit", "closed_call", "custom_jvp_call", "custom_vjp_call", "cond", "ffi_call", "scan")


def text(element: Any, dtype: str) -> str:
    """Return an element as C++."""
    if isinstance(element, str):
        return element
    if dtype == "bool":
        return "true" if element else "false"
    if dtype != "float32":
        return f"{int(element)}" + ("u" if dtype == "uint32" else "")
    if math.isnan(element):
        return '__builtin_nanf("")'
    if math.isinf(element):
        return "-__builtin_inff()" if element < 0 else "__builtin_inff()"
    return float(element).hex() + "f"


def function(
    name: str,
    layout: Layout,
    rules: dict[str, Callable[..., Any]],
    traced: Callable[..., tuple[Any, ...]],
    reads: Sequence[str],
    writes: Sequence[str],
) -> str:
    """Return the C++ of a function: it reads trees of the layout and writes others.

    Args:
        name: Name of the C++ function, which is exported.
        layout: Layout that has the trees.
        rules: Rules of operations.
        traced: Function of the trees `reads`, which returns a tuple of the trees `writes`.
        reads: Names of trees.
        writes: Names of trees; a name that the layout lacks is added.

    Raises:
        UnsupportedError: There is an operation without a rule.
    """
    shapes = [layout.shapes(one) for one in reads]
    closed, made = jax.make_jaxpr(traced, return_shape=True)(*shapes)
    for one, tree in zip(writes, made, strict=True):
        if one not in layout.trees:
            layout.add(one, tree)
    emitter = Emitter(rules)
    values = [_argument(emitter, place) for one in reads for place in layout.trees[one][0]]
    with jax.ensure_compile_time_eval():
        results = emitter.run(closed.jaxpr, closed.consts, values)
    places = [place for one in writes for place in layout.trees[one][0]]
    for place, value in zip(places, results, strict=True):
        if (place.shape, place.dtype) != (value.elements.shape, value.dtype):
            raise ValueError(f"{name} writes {value.dtype} {value.elements.shape} into {place}")
        for k, element in enumerate(value.elements.flat):
            field = FIELDS[place.dtype]
            emitter.lines.append(f"M[{place.offset + k}].{field} = {text(element, value.dtype)};")
    body = "\n".join(emitter.lines)
    return f'extern "C" __attribute__((export_name("{name}"))) void run_{name}() {{\n{body}\n}}\n'


def _argument(emitter: Emitter, place: Place) -> Value:
    field, elements = FIELDS[place.dtype], np.empty(place.size, object)
    looped = place.size >= LOOPED
    for k in range(place.size):
        read = f"M[{place.offset + k}].{field}"
        elements[k] = read if looped else emitter.scalar(place.dtype, read)
    return Value(elements.reshape(place.shape), place.dtype, place.offset if looped else None)


def _needed(jaxpr: Any) -> list[Any]:
    """Return the equations on which an output depends, in their order."""
    wanted = {atom for atom in jaxpr.outvars if not isinstance(atom, core.Literal)}
    kept = []
    for equation in reversed(jaxpr.eqns):
        if wanted.intersection(equation.outvars):
            kept.append(equation)
            wanted.update(a for a in equation.invars if not isinstance(a, core.Literal))
    return kept[::-1]


def _folded(equation: Any, given: list[Value]) -> list[Value]:
    """Return the outputs of an equation whose inputs are numbers."""
    arrays = [jnp.asarray(value.numbers()) for value in given]
    made = equation.primitive.bind(*arrays, **equation.params)
    return [constant(one) for one in (made if equation.primitive.multiple_results else [made])]
