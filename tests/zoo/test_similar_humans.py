import copy
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from assistax_base.errors import IntegrityError, LeakageError
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack
from tests.untrained import params_of
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry, load_registry
from zoo.splitting.create import create_split
from zoo.splitting.similar_humans import (
    THRESHOLD,
    differences,
    probe_actions,
    similar_pairs,
)

ROOT = Path(__file__).parents[2]
ORIGINAL, COPY = "scratch/ippo-d1-s0-v0", "scratch/ippo-d1-s9-v0"


def noisy(params: dict[str, Any], noise: float) -> dict[str, Any]:
    """Return a copy with relative noise in every weight."""
    rng = np.random.default_rng(0)
    if not isinstance(params, dict):
        return (params * (1 + noise * rng.standard_normal(params.shape))).astype(np.float32)
    return {
        name: value if name == "normaliser" else noisy(value, noise)
        for name, value in params.items()
    }


@pytest.fixture
def with_copy(registry: Registry, team, publish_to) -> Callable[..., Registry]:
    """Return a function that publishes a copy of the first human beside a robot of its own."""

    def plant(noise: float, disability: str = "d1") -> Registry:
        robot = team("ippo", disability, 9).params["robot"]
        params = {"robot": robot, "human": noisy(team("ippo", "d1", 0).params["human"], noise)}
        return publish_to([team("ippo", disability, 9, params=params)], registry.path)

    return plant


def custom(registry: Registry) -> Any:
    return create_split(registry.path, task="scratch", rule="custom", train=[ORIGINAL], test=[COPY])


def test_a_nearly_identical_partner_is_refused(with_copy) -> None:
    registry = with_copy(1e-3)
    before = registry.path.read_text()
    with pytest.raises(LeakageError, match=rf"{ORIGINAL} ~ {COPY} \(0\.00\d\)"):
        custom(registry)
    assert registry.path.read_text() == before


def test_changed_copy_is_a_partner_of_its_own(with_copy) -> None:
    assert custom(with_copy(3.0)).test == (COPY,)


def test_leave_one_out_omits_similar_training_partners(with_copy) -> None:
    registry = with_copy(1e-3, "d9")
    held_out = {"rule": "leave-one-disability-out", "held_out": "d9"}
    split = create_split(registry.path, task="scratch", **held_out)
    everyone = set(registry.data.teams)
    assert set(split.test) == {name for name in everyone if "-d9-" in name} and len(split.test) > 1
    assert set(split.train) == everyone - set(split.test) - {ORIGINAL}


def test_existing_splits_are_reported(with_copy) -> None:
    registry = with_copy(1e-3)
    half = registry.split("scratch")
    pairs = similar_pairs(registry, half)
    crossing = half.side(ORIGINAL) != half.side(COPY)
    assert [{pair.train, pair.test} for pair in pairs] == [{ORIGINAL, COPY}] * crossing
    assert len(similar_pairs(registry, half, threshold=10.0)) == len(half.train) * len(half.test)


def test_unfetched_partners_cannot_be_compared(registry: Registry) -> None:
    registry.shard_path(registry.policy(f"{ORIGINAL}/human").shard).unlink()
    with pytest.raises(IntegrityError):
        create_split(registry.path, task="scratch", rule="small-train", n=1)


def test_recurrent_partners_differ_by_memory_alone() -> None:
    """Two policies that agree on every first observation."""
    spec = PolicySpec("human", 4, 2, "gru", hidden=(8,))
    params = jax.tree.map(lambda leaf: np.asarray(leaf) * 20 + 0.1, params_of(spec, 0))
    other = copy.deepcopy(params)
    other["GRUCell_0"]["hn"]["kernel"] = -other["GRUCell_0"]["hn"]["kernel"]
    stacked = jax.tree.map(lambda a, b: np.stack([a, b]).astype(np.float32), params, other)
    actions = probe_actions(PolicyStack(spec, ("a", "b"), stacked))
    np.testing.assert_array_equal(actions[0, 0], actions[1, 0])
    assert differences(actions)[0, 1] > 0.01


def test_differences_are_means_of_absolute_differences() -> None:
    actions = np.array([[[0.0, 1.0]], [[0.5, 1.0]], [[-1.0, -1.0]]])
    expected = [[0, 0.25, 1.5], [0.25, 0, 1.75], [1.5, 1.75, 0]]
    np.testing.assert_allclose(differences(actions), expected)


def test_threshold_separates_copies_from_training_seeds() -> None:
    registry = load_registry(ROOT / "registry.json")
    (group,) = load_stacks(registry, registry.select("scratch/ippo-*-v1/human"))
    actions = probe_actions(group)
    distances = differences(actions)[np.triu_indices(len(group.ids), 1)]
    assert distances.min() > 2.5 * THRESHOLD
    copies = dataclasses.replace(group, params=noisy(group.params, 0.1))
    assert np.abs(probe_actions(copies) - actions).mean(axis=(1, 2, 3)).max() < THRESHOLD
