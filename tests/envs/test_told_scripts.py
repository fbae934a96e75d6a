"""A script that is told the wishes acts by each of them, and reads them where robots are told."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import make
from assistax_envs.own_settings import key_of
from assistax_envs.persons import person_params, persons
from assistax_envs.persons.measure import SWEEPS, probed
from assistax_envs.preferences import PREFERRED, VALUES
from assistax_envs.tasks.chain import SCRIPTS, observed_wishes, told_script_of

TOLD = tuple(name for name, script in SCRIPTS.items() if script.told)


def test_every_task_with_wishes_has_a_told_script() -> None:
    assert set(TOLD) == set(PREFERRED)
    with pytest.raises(ValueError, match="script of scratch cannot be told"):
        told_script_of("scratch", make("scratch").model)


@pytest.mark.parametrize("task", TOLD)
def test_each_wish_is_a_number_of_the_script(task: str) -> None:
    script, names = SCRIPTS[task], PREFERRED[task]
    numbers = {**script.numbers, **script.careful}
    assert script.told is not None
    wishes = {name: jnp.full((2, 1), VALUES[name][1]) for name in names}
    usual = script.told(numbers, wishes)
    assert set(usual) <= set(script.numbers)
    for name in names:
        other = script.told(numbers, wishes | {name: 2.0 * wishes[name]})
        changed = [key for key in usual if not np.array_equal(usual[key], other[key])]
        assert len(changed) == 1, (name, changed)


@pytest.mark.slow_for("bath", "lift", "feeding", "brushing")
@pytest.mark.parametrize("task", TOLD)
def test_wishes_are_read_where_robots_are_told(task: str) -> None:
    env, rows = make(task, told=("human", "robot")), persons(task)[:4]
    state = env.reset(jax.random.split(key_of(7), 4), person_params(task, rows))
    own = state.params.preference.of(task)
    np.testing.assert_allclose(observed_wishes(task, state.obs["robot"]), own, rtol=1e-5)
    act = told_script_of(task, env.model)
    assert act(state.obs["robot"], own).shape == (4, 7)


def test_probe_sweeps_each_wish_over_its_usual_values() -> None:
    times = jnp.arange(0, 100 * int(max(SWEEPS)), 10)
    seen = np.asarray(jax.vmap(lambda time: probed("gentle_scratch", time)[0])(times))
    for column, name in zip(seen.T, PREFERRED["gentle_scratch"], strict=True):
        np.testing.assert_allclose([column.min(), column.max()], VALUES[name][::2], rtol=0.1)
