"""Settings of the user's process: the same bits, or one sentence that names the setting."""

import contextlib
import functools
import json
import os
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import jax
import pytest

from assistax_envs.own_settings import OURS
from tests.api.settings_entries import ENTRIES, outcome

ROOT = Path(__file__).parents[2]
# A value of each of JAX's settings that a user may choose, by the name for `jax.config.update`.
CHANGED: dict[str, Any] = {
    "jax_allow_f16_reductions": False,
    "jax_check_tracer_leaks": True,
    "jax_debug_infs": True,
    "jax_debug_key_reuse": True,
    "jax_debug_nans": True,
    "jax_default_matmul_precision": "bfloat16",
    "jax_default_prng_impl": "rbg",
    "jax_disable_jit": True,
    "jax_enable_custom_prng": True,
    "jax_enable_x64": True,
    "jax_legacy_prng_key": "error",
    "jax_no_execution": True,
    "jax_no_tracing": True,
    "jax_numpy_dtype_promotion": "strict",
    "jax_random_seed_offset": 7,
    "jax_softmax_custom_jvp": True,
    "jax_threefry_partitionable": False,
    "jax_transfer_guard": "disallow",
    "jax_transfer_guard_device_to_device": "disallow",
    "jax_transfer_guard_device_to_host": "disallow",
    "jax_transfer_guard_host_to_device": "disallow",
}
REFUSED: dict[str, Any] = {
    "jax_error_checking_behavior_divide": "raise",
    "jax_error_checking_behavior_nan": "raise",
    "jax_error_checking_behavior_oob": "raise",
    "jax_high_dynamic_range_gumbel": True,
}
# Under these a user's own compiled program cannot run, or is checked as a whole.
FOR_HOSTS_ONLY = (
    *("jax_debug_key_reuse", "jax_disable_jit", "jax_no_execution", "jax_no_tracing"),
    *(name for name in CHANGED if name.startswith("jax_transfer_guard")),
)
FUNCTIONAL = ("functional_form", "own_program")
TOGETHER = {name: value for name, value in CHANGED.items() if name not in FOR_HOSTS_ONLY}


@contextlib.contextmanager
def configured(**changes: Any) -> Generator[None]:
    """Change settings as a user does, and set them back."""
    before = {name: jax.config.values[name] for name in changes}
    for name, value in changes.items():
        jax.config.update(name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 3)


def usual(name: str) -> str:
    """Return an entry's digest in a process without settings, of this process's compiler."""
    found = outcome(name, "native")
    assert len(found) == 16, found
    return found


def test_each_setting_of_ours_is_tried() -> None:
    assert OURS.keys() <= CHANGED.keys() | REFUSED.keys()
    for name, value in (CHANGED | REFUSED).items():
        assert value not in OURS.get(name, ()), name


@pytest.mark.slow
@pytest.mark.usefixtures("short", "optimised")
def test_a_setting_that_gets_through_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = usual("vector_form")
    monkeypatch.delitem(OURS, "jax_threefry_partitionable")
    with configured(jax_threefry_partitionable=False):
        assert outcome("vector_form", "native") != expected


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("name", REFUSED)
def test_a_setting_that_cannot_be_ours_is_named(name: str) -> None:
    with configured(**{name: REFUSED[name]}):
        for message in (outcome(entry, "native") for entry in ENTRIES):
            assert message.startswith(f"ValueError: JAX's {name} is {REFUSED[name]!r} "), message
            assert "\n" not in message and name.upper() in message


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("entry", [entry for entry in ENTRIES if entry not in FUNCTIONAL])
def test_a_guard_of_explicit_transfers_is_named(entry: str) -> None:
    """XLA's threads hand arrays to callbacks by such transfers, where no setting of ours is."""
    with configured(jax_transfer_guard="disallow_explicit"):
        message = outcome(entry, "native")
    words = "ValueError: JAX's jax_transfer_guard is 'disallow_explicit' "
    assert message.startswith(words), message


@pytest.mark.slow
@pytest.mark.usefixtures("short", "optimised")
@pytest.mark.parametrize("entry", ENTRIES)
def test_config_update_changes_no_bit(entry: str) -> None:
    expected = usual(entry)
    with configured(**TOGETHER):
        assert outcome(entry, "native") == expected
    if entry not in FUNCTIONAL:
        with configured(**{name: CHANGED[name] for name in FOR_HOSTS_ONLY}):
            assert outcome(entry, "native") == expected


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("group", [FOR_HOSTS_ONLY, tuple(TOGETHER)], ids=["hosts", "others"])
def test_variables_change_no_bit(group: tuple[str, ...]) -> None:
    """In a process of its own, on vectors and in an evaluation."""
    names = ["evaluation", "vector_form"]
    names += [] if group == FOR_HOSTS_ONLY else ["own_program"]
    variables = {name.upper(): str(CHANGED[name]) for name in group}
    expected = without_variables(("evaluation", "vector_form", "own_program"))
    assert separately(names, **variables) == {name: expected[name] for name in names}


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("backend", ["fused", "native"])
@pytest.mark.parametrize("setting", ["JAX_DEFAULT_PRNG_IMPL=rbg", "JAX_ENABLE_X64=1"])
def test_whole_episodes_stay_the_same(backend: str, setting: str) -> None:
    name, _, value = setting.partition("=")
    found = separately(["evaluation"], backend, 1000, **{name: value})
    assert found == without_variables(("evaluation",), backend, 1000)


@functools.cache
def without_variables(
    names: tuple[str, ...], backend: str = "native", length: int = 3
) -> dict[str, str]:
    """Return digests of entries in a process of its own, without settings."""
    return separately(list(names), backend, length)


def separately(
    names: list[str], backend: str = "native", length: int = 3, **variables: str
) -> dict[str, str]:
    """Return digests of entries in a process with these variables."""
    command = [sys.executable, "-m", "tests.api.settings_entries", backend, str(length), *names]
    settings = os.environ | variables
    done = subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-800:]
    found = json.loads(done.stdout)
    assert all(len(digest) == 16 for digest in found.values()), found
    return found
