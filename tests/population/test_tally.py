"""What an episode comes to, added up step by step, against a second pass over the whole episode."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np

from population.play.tally import SECOND, accumulate, begin, begin_window

STEPS, N = 3 * SECOND, 4


def _episode(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    touched = rng.random((STEPS, N)) < 0.6
    touched[:20] = False
    touched[:, 3] = False  # nobody touches the last one
    force = touched * rng.uniform(0.5, 30.0, (STEPS, N))
    return {
        "force": force.astype(np.float32),
        "together": (1.3 * force).astype(np.float32),
        "at_end": touched & (rng.random((STEPS, N)) < 0.3),
        "speed": rng.uniform(0.0, 0.5, (STEPS, N)).astype(np.float32),
        "face": rng.uniform(0.1, 0.9, (STEPS, N)).astype(np.float32),
    }


def _state(values: dict[str, np.ndarray], time: int, stops: np.ndarray) -> Any:
    zero, false = jnp.zeros(N), jnp.zeros(N, bool)
    row = {name: jnp.asarray(value[time]) for name, value in values.items()}
    measures = {"distance": zero, "success": false, "contact": row["force"], "violated": false}
    return SimpleNamespace(
        measures=SimpleNamespace(**measures, **row),
        reward=zero,
        terms={},
        terminated=jnp.asarray(time >= stops),
        truncated=false,
        nonfinite=false,
    )


def test_touch_measures_equal_a_second_pass() -> None:
    values, stops = _episode(3), np.array([STEPS, STEPS, 70, STEPS])
    state = _state(values, 0, stops)
    tally, window = begin(state, {}), begin_window(state)
    assert window is not None
    for time in range(1, STEPS):
        after = _state(values, time, stops)
        window = window.at[(time - 1) % SECOND].set(after.measures.force)
        tally = accumulate(tally, state, after, {}, window, jnp.asarray(time - 1))
        state = after
    for i, last in enumerate(np.minimum(stops, STEPS - 1)):
        force = values["force"][1 : last + 1, i]
        padded = np.concatenate([np.zeros(SECOND - 1), force])
        means = np.convolve(padded, np.full(SECOND, 1 / SECOND), "valid")
        touch = {name: float(value[i]) for name, value in tally.touch.items()}
        assert touch["end_steps"] == values["at_end"][1 : last + 1, i].sum()
        np.testing.assert_allclose(touch["sustained_force"], means.max(), rtol=1e-4)
        np.testing.assert_allclose(
            touch["together_peak"], values["together"][1 : last + 1, i].max(), rtol=1e-6
        )
        np.testing.assert_allclose(touch["face_least"], values["face"][: last + 1, i].min())
        first = int(tally.first_contact[i])
        expected = values["speed"][first - 1, i] if first else 0.0
        np.testing.assert_allclose(touch["touch_speed"], expected)
    assert touch["sustained_force"] == touch["touch_speed"] == 0.0  # of whom nobody touched


def test_nothing_is_kept_where_nothing_is_measured() -> None:
    values = _episode(4)
    state = _state(values, 0, np.full(N, STEPS))
    state.measures = SimpleNamespace(force=jnp.zeros(N), contact=None, violated=None)
    assert begin(state, {}).touch == {} and begin_window(state) is None
