"""A simulation's numbers depend on its own arguments alone, to the bit."""

import numpy as np
import pytest

from tests.envs.fused.scenes import (
    TASKS,
    Engine,
    States,
    engine,
    random_states,
    scene,
    team_states,
    touching_states,
)


def mixture(task: str) -> States:
    """Return calm, limited, touching and broken states side by side, in no order."""
    model = scene(task)
    parts = random_states(model, 40, 7), touching_states(task), team_states(task)[0][:60]
    fields = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("qpos", "qvel", "ctrl")
    )
    states = States(*fields)
    states.qpos[5], states.qvel[50, 3], states.qpos[70, 9] = np.nan, np.inf, 1e20
    return states[np.random.default_rng(9).permutation(len(states))]


def same(a, b) -> bool:
    """Return whether all arrays have the same bits; one not-a-number is as good as another."""
    return all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True)) and all(
        np.array_equal(np.signbit(x[x == 0]), np.signbit(y[y == 0]))
        for x, y in zip(a, b, strict=True)
    )


@pytest.mark.slow_for("gentle_feeding", "gentle_brushing", "gentle_bath", "gentle_scratch")
@pytest.mark.parametrize("task", TASKS)
def test_neighbours_and_batch_size_do_not_matter(task: str) -> None:
    states, run = mixture(task), engine(task)
    want = run(states, substeps=4)
    assert same(run(states, substeps=4), want)
    order = np.random.default_rng(10).permutation(len(states))
    assert same(run(states[order], substeps=4), [x[order] for x in want])
    for size in range(1, 18):
        first = 3 * size
        part = slice(first, first + size)
        assert same(run(states[part], substeps=4), [x[part] for x in want]), size


@pytest.mark.parametrize("lanes", [1, 4, 16])
def test_lanes_do_not_matter(lanes: int) -> None:
    states = mixture("bed_bath")
    want = engine("bed_bath")(states, substeps=4)
    assert same(engine("bed_bath", lanes)(states, substeps=4), want)


def test_the_processor_does_not_matter() -> None:
    states = mixture("bed_bath")
    plain = Engine(scene("bed_bath"), lanes=4, features=())  # without AVX and FMA
    assert same(plain(states, substeps=4), engine("bed_bath")(states, substeps=4))


def test_a_changed_bit_is_seen() -> None:
    states = mixture("scratch")
    want = engine("scratch")(states)
    states.qpos[3, 4] = np.nextafter(states.qpos[3, 4], np.float32(10))
    assert not same(engine("scratch")(states), want)
