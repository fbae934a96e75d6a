"""One policy in one seat: the same actions as the network's, and clear refusals."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_base.errors import UnknownIdError, ZooError
from assistax_envs import DISABILITY_SETTINGS
from evaluation.cast.partners import zoo_partner
from evaluation.cast.seats import seat_policy
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from tests import untrained
from tests.untrained import untrained_team
from zoo.parameters.storage import write_policy_file
from zoo.registry import Registry, load_registry

ROBOT = PolicySpec("robot", observation_size=6, action_size=2, hidden=(4,))
HUMAN = PolicySpec("human", observation_size=5, action_size=3, hidden=(4,), torso="gru")


class Seats:
    observation_size = {"robot": 6, "human": 5}  # noqa: RUF012
    action_size = {"robot": 2, "human": 3}  # noqa: RUF012


def params_of(spec: PolicySpec, seed: int) -> dict[str, Any]:
    # An untrained head acts around zero.
    return jax.tree.map(lambda leaf: leaf + 0.3, untrained.params_of(spec, seed))


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    teams = [
        untrained_team(
            "d9", seed, robot=(ROBOT, params_of(ROBOT, seed)), human=(HUMAN, params_of(HUMAN, seed))
        )
        for seed in range(4)
    ]
    return load_registry(untrained.published(teams, tmp_path_factory.mktemp("zoo")))


def test_zoo_partner_acts_as_its_network(registry: Registry):
    partner = zoo_partner(registry, "scratch/ippo-d9-s2-v0")
    assert partner.id == "scratch/ippo-d9-s2-v0/human"
    assert partner.setting == DISABILITY_SETTINGS["d9"]
    policy, params = Policy(HUMAN), params_of(HUMAN, 2)
    jax.tree.map(np.testing.assert_array_equal, partner.params, jax.device_get(params))
    carry = policy.initial_carry(())
    rng = np.random.default_rng(0)
    for step in range(3):
        obs = rng.normal(size=5).astype(np.float32)
        carry, expected = policy.act(params, carry, jnp.asarray(obs), jnp.array(step == 0))
        action = partner(obs)
        assert action.shape == (3,) and np.abs(action).max() > 0.01
        np.testing.assert_allclose(action, expected, atol=1e-6)


def test_reset_clears_memory_for_batches(registry: Registry):
    partner = zoo_partner(registry, "scratch/ippo-d9-s0-v0/human")
    obs = np.full(5, 0.7, np.float32)
    first, second = partner(obs), partner(obs)
    assert not np.array_equal(first, second)
    with pytest.raises(ValueError, match=r"in an episode that began with \(5,\); call reset"):
        partner(np.stack([obs] * 3))
    partner.reset()
    np.testing.assert_array_equal(partner(obs), first)
    partner.reset(3)
    np.testing.assert_allclose(partner(np.stack([obs] * 3)), np.stack([first] * 3), atol=1e-6)


def seat(reference: str, role: str, registry: Registry):
    return seat_policy(reference, role, Seats(), lambda: registry, "scratch", seed=1)


def test_every_form_takes_its_seat(registry: Registry, tmp_path: Path):
    obs = {role: np.full(size, 0.5, np.float32) for role, size in Seats.observation_size.items()}
    assert (seat("zero", "human", registry)(obs["human"]) == np.zeros(3)).all()
    drawn = [seat("random", role, registry)(obs[role]) for role in ("robot", "robot", "human")]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert np.abs(drawn[2]).max() <= 1.0 and drawn[2][:2].tolist() != drawn[0].tolist()
    path = tmp_path / "human.safetensors"
    write_policy_file(path, HUMAN, params_of(HUMAN, 0), {"disability": "d4"})
    from_file = seat(str(path), "human", registry)
    assert from_file.setting == DISABILITY_SETTINGS["d4"]
    from_zoo = seat("zoo:scratch/ippo-d9-s0-v0/human", "human", registry)
    np.testing.assert_array_equal(from_file(obs["human"]), from_zoo(obs["human"]))


def test_outside_robot_gets_batches_of_one(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    code = "import numpy as np\nmake = lambda: lambda obs: np.ones((len(obs), 2)) * obs[:, :1]"
    (tmp_path / "outside_robot.py").write_text(code)
    monkeypatch.syspath_prepend(str(tmp_path))
    robot = seat("python:outside_robot:make", "robot", registry)
    for value in (0.5, -0.25):
        action = robot(np.full(6, value, np.float32))
        np.testing.assert_array_equal(action, np.full(2, value, np.float32))


def test_refusals(registry: Registry, tmp_path: Path):
    with pytest.raises(ValueError, match="policy 'best' has an unknown form; allowed are an id"):
        seat("best", "robot", registry)
    with pytest.raises(ValueError, match="policy 'python:a:b' cannot play the human"):
        seat("python:a:b", "human", registry)
    with pytest.raises(UnknownIdError, match="nearest: scratch/ippo-d9-s0-v0"):
        seat("zoo:scratch/ippo-d9-s0-v9/robot", "robot", registry)
    with pytest.raises(UnknownIdError, match=r"is not one policy: .*, found 4"):
        zoo_partner(registry, "scratch/ippo-*")
    with pytest.raises(ZooError, match="no such file"):
        seat(str(tmp_path / "gone.safetensors"), "robot", registry)
    path = tmp_path / "robot.safetensors"
    write_policy_file(path, ROBOT, params_of(ROBOT, 0))
    with pytest.raises(ValueError, match="plays the robot, not the human; give it as the robot"):
        seat(str(path), "human", registry)
    other = PolicySpec("robot", observation_size=9, action_size=2, hidden=(4,))
    write_policy_file(path, other, params_of(other, 0))
    with pytest.raises(ValueError, match="9 numbers; the robot of task scratch has 6"):
        seat(str(path), "robot", registry)
    with pytest.raises(ValueError, match=r"got observations \(4,\); expected \[..., 5\]"):
        zoo_partner(registry, "scratch/ippo-d9-s0-v0")(np.zeros(4))
