"""What a person felt of an episode, added up step by step, against a second pass over it."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs.tasks.care import IMPACT, NONE, PRESSED, WITHIN
from population.play.caring import LATE, Caring, caring_columns
from population.play.tally import Tally, accumulate, begin

STEPS, N, W = 1000, 4, 2
LIKED = np.array([[4.0, 0.05]] * N) * np.array([[1.0], [0.5], [2.0], [1.0]])


def _episode(seed: int) -> dict[str, np.ndarray]:
    """Return an episode of four persons; the last one is never touched."""
    rng = np.random.default_rng(seed)
    done = LIKED * np.exp(rng.normal(0.2, 0.5, (STEPS, N, W)))
    judged = rng.random((STEPS, N, W)) < 0.4
    judged[:, 3] = False
    judged[LATE:, 2, 1] = False  # judged early alone
    felt = judged.any(axis=2) | (rng.random((STEPS, N)) < 0.1)
    felt[:, 3] = False
    return {
        "done": done.astype(np.float32),
        "judged": judged,
        "felt": felt,
        "discomfort": (rng.random((STEPS, N)) < 0.3) * rng.random((STEPS, N)).astype(np.float32),
        "violation": np.zeros((STEPS, N), np.int32),
        "success": np.ones((STEPS, N), bool),
        "nonfinite": np.zeros((STEPS, N), bool),
        "terminated": np.zeros((STEPS, N), bool),
    }


def _state(episode: dict[str, np.ndarray], step: int) -> Any:
    row = {name: jnp.asarray(values[step]) for name, values in episode.items()}
    outcome = {name: row.pop(name) for name in ("nonfinite", "terminated")}
    zero = jnp.zeros(N)
    measures = {"force": zero, "distance": zero, "contact": zero, "liked": jnp.asarray(LIKED)}
    violated = row["violation"] != NONE
    return SimpleNamespace(
        measures=SimpleNamespace(**measures, **row, violated=violated),
        reward=zero,
        terms={},
        truncated=jnp.zeros(N, bool),
        **outcome,
    )


def _played(episode: dict[str, np.ndarray]) -> Tally:
    state = _state(episode, 0)
    tally = begin(state, {})
    for step in range(STEPS):
        after = _state(episode, step)
        tally = accumulate(tally, state, after, {}, None, jnp.asarray(step))
        state = after
    return tally


def _columns(episode: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    caring = _played(episode).caring
    assert caring is not None
    return caring_columns(_as_numpy(caring), ("force", "speed"))


def _as_numpy(caring: Caring) -> Caring:
    def arrays(of: Any) -> dict[str, np.ndarray]:
        names = (field.name for field in dataclasses.fields(of) if field.name != "wishes")
        return {name: np.asarray(getattr(of, name)) for name in names}

    wishes = tuple(dataclasses.replace(wish, **arrays(wish)) for wish in caring.wishes)
    return dataclasses.replace(caring, wishes=wishes, **arrays(caring))


def test_wishes_equal_a_second_pass_over_seconds_10_to_20() -> None:
    episode = _episode(5)
    columns = _columns(episode)
    late = np.arange(STEPS) * 0.02 >= 10.0
    for w, name in enumerate(("force", "speed")):
        np.testing.assert_allclose(columns[f"liked_{name}"], LIKED[:, w], rtol=1e-6)
        for i in range(N):
            values = episode["done"][late & episode["judged"][:, i, w], i, w]
            if not values.size:
                assert np.isnan(columns[f"done_{name}"][i]) and np.isnan(
                    columns[f"within_{name}"][i]
                )
                continue
            mean = np.exp(np.log(values).mean())
            assert columns[f"done_{name}"][i] == pytest.approx(mean, rel=1e-4)
            ratio = values / LIKED[i, w]
            near = (ratio < WITHIN) & (ratio > 1.0 / WITHIN)
            assert columns[f"within_{name}"][i] == pytest.approx(near.mean())
    assert np.isnan(columns["done_speed"][2:]).all()


def test_discomfort_counts_the_steps_of_the_whole_episode_that_were_felt() -> None:
    episode = _episode(6)
    uneasy = (episode["felt"] & (episode["discomfort"] > 0.0)).sum(axis=0)
    expected = uneasy / np.maximum(episode["felt"].sum(axis=0), 1)
    share = _columns(episode)["discomfort_share"]
    np.testing.assert_allclose(share, expected)
    assert share[3] == 0.0 and 0.2 < share[0] < 0.4


def test_nothing_counts_after_the_end_or_of_broken_physics() -> None:
    episode = _episode(7)
    episode["terminated"][700, 0] = True
    episode["nonfinite"][600:, 1] = True
    columns = _columns(episode)
    for i, end in ((0, 701), (1, 600)):
        values = episode["done"][LATE:end, i, 0][episode["judged"][LATE:end, i, 0]]
        assert columns["done_force"][i] == pytest.approx(np.exp(np.log(values).mean()), rel=1e-4)


def test_violation_and_success_are_those_of_the_last_step() -> None:
    """The goal was reached with care, and then the care ended."""
    episode = _episode(8)
    episode["success"][:600] = False
    for i, kind in ((0, IMPACT), (1, PRESSED)):
        episode["violation"][800:, i] = kind
        episode["success"][800:, i] = False
        episode["terminated"][800:, i] = True
    tally = _played(episode)
    assert _columns(episode)["violation"].tolist() == [IMPACT, PRESSED, NONE, NONE]
    assert np.asarray(tally.success).tolist() == [False, False, True, True]
    assert np.asarray(tally.violated).tolist() == [True, True, False, False]


def test_tasks_without_wishes_have_no_such_columns() -> None:
    state = _state(_episode(9), 0)
    state.measures.done = None
    assert begin(state, {}).caring is None
    assert caring_columns(None, ()) == {}
