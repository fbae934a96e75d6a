"""Our settings of JAX inside our programs, and a process's own settings outside."""

import threading
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params, make
from assistax_envs.adapters.jaxmarl import AssistaxMarlEnv
from assistax_envs.own_settings import OURS, found_settings, key_of, own_settings
from tests.api.test_process_settings import CHANGED, TOGETHER, configured

SWITCHED = [name for name in OURS if name in CHANGED]


@pytest.mark.parametrize("name", SWITCHED)
def test_inside_a_setting_is_ours(name: str) -> None:
    with configured(**{name: CHANGED[name]}):
        theirs = jax.config.values[name]
        assert theirs not in OURS[name]
        with own_settings():
            assert jax.config.values[name] in OURS[name]
        assert jax.config.values[name] == theirs


def test_an_error_gives_the_settings_back() -> None:
    with configured(jax_enable_x64=True):
        with pytest.raises(ZeroDivisionError), own_settings():
            raise ZeroDivisionError
        assert jax.config.values["jax_enable_x64"]


def test_decorator_sets_them_in_a_thread() -> None:
    seen: dict[str, Any] = {}

    def look(name: str) -> None:
        seen[name] = jax.config.values["jax_default_prng_impl"]

    works: dict[str, Callable[[str], None]] = {"bare": look, "own": own_settings()(look)}
    with configured(jax_default_prng_impl="rbg"), own_settings():
        for name, work in works.items():
            thread = threading.Thread(target=work, args=(name,))
            thread.start()
            thread.join()
    assert seen == {"bare": "rbg", "own": "threefry2x32"}


@pytest.mark.parametrize("changes", [{}, TOGETHER], ids=["usual", "changed"])
def test_keys_are_those_of_jax(changes: dict[str, Any]) -> None:
    seeds = np.array([0, 5, 2**31, 2**32 - 1], np.uint32)
    expected = jax.random.key_data(jax.vmap(jax.random.key)(seeds))
    with configured(**changes):
        assert jax.random.key_impl(key_of(seeds)) == "threefry2x32"
        assert (jax.random.key_data(key_of(seeds)) == expected).all()
        for seed, words in zip(seeds.tolist(), expected, strict=True):
            assert (jax.random.key_data(key_of(seed)) == words).all()
            assert (jax.random.key_data(key_of(seed + 2**40)) == words).all()


def test_settings_enter_nothing_in_an_ordinary_process() -> None:
    traced = []
    program = jax.jit(lambda x: traced.append(1) or x + 1)
    own = own_settings()(program)
    for call in (program, own, own, program):
        call(1.0)
    assert len(traced) == 1


def test_another_process_compiles_once_too() -> None:
    traced = []
    own = own_settings()(jax.jit(lambda x: traced.append(1) or x + 1))
    with configured(**TOGETHER):
        for _ in range(3):
            own(np.float32(1.0))
    assert len(traced) == 1


def test_keys_of_another_generator_are_refused() -> None:
    env, params = make("scratch", "native"), disability_params(["d1"])
    keys = jax.random.key(0, impl="rbg")[None]
    for reset in (env.reset, jax.jit(env.reset)):
        with pytest.raises(ValueError, match=r"generator rbg.*impl='threefry2x32'"):
            reset(keys, params)
    raw: Any = jax.random.PRNGKey(0, impl="rbg")
    with pytest.raises(ValueError, match=r"has \(4,\) words.*impl='threefry2x32'"):
        AssistaxMarlEnv("scratch", backend="native").reset(raw)


def test_actions_of_double_precision_change_nothing() -> None:
    env, params = make("scratch", "native"), disability_params(["d1"])
    state = jax.jit(env.reset)(key_of(0)[None], params)
    action = {"robot": np.full((1, 7), 0.5), "human": np.full((1, 3), -0.5)}
    expected = jax.jit(env.step)(state, action)
    with configured(jax_enable_x64=True):
        wide = {role: jnp.asarray(values) for role, values in action.items()}
        assert wide["robot"].dtype == np.float64
        found = jax.jit(env.step)(state, wide)
    for role, obs in expected.obs.items():
        assert found.obs[role].dtype == np.float32
        assert (np.asarray(found.obs[role]) == np.asarray(obs)).all()


def test_found_settings_are_named() -> None:
    usual = found_settings()
    with configured(jax_default_prng_impl="rbg", jax_optimization_level="O1"):
        found = found_settings()
    assert found == usual | {"jax_default_prng_impl": "rbg", "jax_optimization_level": "O1"}
