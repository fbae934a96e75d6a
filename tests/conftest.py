"""What holds for every test: strict JAX on the CPU, an own compilation cache, checked annotations.

Rank promotion is an error in tests. MJX itself promotes ranks: whatever calls into it does so under
`jax.numpy_rank_promotion("allow")`, which also serves users who are strict.
"""

import functools
import gc
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any, get_type_hints

import jaxtyping
import pytest
from beartype import BeartypeConf, beartype
from beartype.roar import BeartypeClawDecorWarning
from jaxtyping import install_import_hook

PACKAGES = (
    "assistax_base",
    "assistax_envs",
    "population",
    "zoo",
    "evaluation",
    "assistax_zoo",
    "assistax_workshop",
    "tools",
)

gc.set_threshold(100_000, 50, 100)  # or a tenth of the time goes to looking for garbage

# Through the environment, not `jax.config`: tests that never import JAX stay quick, and
# subprocesses are strict too.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path("~/.cache/assistax-zoo/xla-tests").expanduser())
)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")  # small programs too
# Of entries that another process writes or, killed, left half written: see pyproject.toml too.
TORN = "ignore:Error reading persistent compilation cache entry:UserWarning"
os.environ.setdefault("PYTHONWARNINGS", TORN)  # of processes that tests start
if tuple(int(part) for part in version("jaxlib").split(".")[:3]) < (0, 11, 1):
    # Or MJX crawls (see assistax_envs.physics.mjx). From 0.11.1 on it does not, and XLA aborts on
    # the unknown flag.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

# An int is a float here as in PEP 484, and what beartype cannot check, such as a Protocol, stays
# unchecked. What violates its type is a TypeError, as it would be in use.
CHECK = BeartypeConf(
    is_pep484_tower=True,
    warning_cls_on_decorator_exception=BeartypeClawDecorWarning,
    violation_type=TypeError,
)


def check_annotations(function: FunctionType, *_: Any, **__: Any) -> Callable:
    """Check a function's annotations in calls; no constructor's: JAX puts placeholders in."""
    if function.__name__ == "__init__":
        return function
    return beartype(conf=CHECK)(function)


def check_types(decorated: Any = None, *, typechecker: Any) -> Any:
    """Check types alone where a module annotates no shapes: jaxtyping takes ten times as long."""
    if decorated is None:
        return functools.partial(check_types, typechecker=typechecker)
    if annotates_shapes(decorated.__module__):
        return check_shapes(decorated, typechecker=typechecker)
    if isinstance(decorated, FunctionType):
        names, hints = decorated.__globals__, decorated.__annotations__
        decorated.__annotations__ = {name: resolve(hint, names) for name, hint in hints.items()}
        return check_annotations(decorated)
    return decorated


@functools.cache
def annotates_shapes(module: str) -> bool:
    """Return whether a module takes shapes from jaxtyping."""
    text = Path(str(sys.modules[module].__file__)).read_text(encoding="utf-8")
    return "from jaxtyping import" in text


def resolve(hint: Any, names: dict[str, Any]) -> Any:
    """Return a hint without strings; any value fits one that names what only a checker imports."""
    holder = type("Holder", (), {"__annotations__": {"it": hint}})
    try:
        return get_type_hints(holder, names, include_extras=True)["it"]
    except Exception:
        return Any


# The hook decorates by this name.
check_shapes = jaxtyping.jaxtyped
vars(jaxtyping)["jaxtyped"] = check_types
sys.modules["tests_conftest"] = sys.modules[__name__]  # the hook takes its checker by name
install_import_hook(PACKAGES, "tests_conftest.check_annotations")


# Moment, in seconds of Unix time, from which no test begins: for CI on a slow machine. The files
# then begin at another place for each commit, so none is always the one without time.
UNTIL = float(os.environ.get("TESTS_UNTIL", "inf"))
NO_TIME = "TESTS_UNTIL is over"


@pytest.hookimpl(trylast=True)  # once `-m` has chosen the tests
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin the files at a place of the commit's, if there may be no time for all."""
    if math.isinf(UNTIL) or not items:
        return
    files = list(dict.fromkeys(item.path for item in items))
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    commit = subprocess.run(command, capture_output=True, text=True).stdout
    first = int(commit or "0", 16) % len(files)
    place = {path: (number - first) % len(files) for number, path in enumerate(files)}
    items.sort(key=lambda item: place[item.path])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Skip a test for which there is no time; other runs that a test starts have theirs."""
    os.environ.pop("TESTS_UNTIL", None)
    if time.time() > UNTIL:
        pytest.skip(NO_TIME)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say for how many tests there was no time."""
    skipped = terminalreporter.stats.get("skipped", ())
    if left := sum(NO_TIME in str(report.longrepr) for report in skipped):
        terminalreporter.write_line(
            f"no time was left for {left} tests: run them without TESTS_UNTIL"
        )


@pytest.hookimpl(wrapper=True)  # here are all cases of a test, whichever will be chosen
def pytest_pycollect_makeitem(collector: pytest.Collector, name: str) -> Generator[None, Any, Any]:
    """Mark as slow the cases of a test whose id has a word of its mark `slow_for`.

    Raises:
        CollectError: A word is in no case's id.
    """
    made = yield
    cases = {}
    if isinstance(made, list):
        cases = {case.name.partition("[")[2].removesuffix("]"): case for case in made}
    marks = [mark for case in cases.values() for mark in case.iter_markers("slow_for")]
    for word in dict.fromkeys(word for mark in marks for word in mark.args):
        slow = [case for id, case in cases.items() if word in id]
        if not slow:
            raise collector.CollectError(
                f"{collector.nodeid}::{name}: slow_for has {word!r}, which is in no case's id; "
                f"ids are {', '.join(cases)}"
            )
        for case in slow:
            case.add_marker(pytest.mark.slow)
    return made


@pytest.fixture
def install_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that installs, for one test, a package of one entry point.

    Modules of the package may be written into `tmp_path`.
    """
    from assistax_base import extensions

    # A process reads the entry points once, and this one did.
    monkeypatch.setattr(extensions, "_read", extensions._read.__wrapped__)
    monkeypatch.syspath_prepend(tmp_path)

    def install(group: str, name: str, value: str, package: str = "outside") -> None:
        about = tmp_path / f"{package}-0.3.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.3\n")
        (about / "entry_points.txt").write_text(f"[{group}]\n{name} = {value}\n")

    return install


@pytest.fixture(scope="module")
def optimised() -> Iterator[None]:
    """Compile as users do, here and in processes that a test starts: bits are compared.

    `make test` compiles without optimisation, because half of its time was the compiler's.
    """
    import jax

    name = "jax_disable_most_optimizations"
    quick = jax.config.read(name)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(name.upper(), "0")
        if quick:
            jax.clear_caches()  # what other files compiled
            jax.config.update(name, False)
        yield
        if quick:
            jax.config.update(name, True)
            jax.clear_caches()
