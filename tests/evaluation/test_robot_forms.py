"""Every form of robot answers alike, and is told when its episodes begin."""

from typing import Any

import numpy as np
import pytest
from flax import linen

from evaluation.robot_forms import as_robot

OBS = np.linspace(-1.0, 1.0, 8, dtype=np.float32).reshape(4, 2)


class Acting:
    rows: int | None = None

    def act(self, obs: np.ndarray) -> np.ndarray:
        return 2.0 * obs

    def reset(self, rows: int) -> None:
        self.rows = rows


class Predicting:
    """As a recurrent model of Stable-Baselines3: counts its steps in its state."""

    def predict(
        self,
        obs: np.ndarray,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, Any]:
        assert deterministic
        state = np.zeros(len(obs)) if state is None else np.where(episode_start, 0, state)
        return 2.0 * obs + state[:, None], state + 1


class Doubling(linen.Module):
    @linen.compact
    def __call__(self, obs: Any) -> Any:
        return linen.Dense(2, kernel_init=lambda *_: 2.0 * np.eye(2, dtype=np.float32))(obs)


MODULE = Doubling()
PARAMS = MODULE.init(__import__("jax").random.key(0), OBS)


@pytest.mark.parametrize(
    "robot",
    [
        lambda obs: 2.0 * obs,
        lambda obs: (2.0 * obs).tolist(),
        Acting(),
        Predicting(),
        (MODULE, PARAMS),
        (MODULE, PARAMS["params"]),
        MODULE.bind(PARAMS),
    ],
    ids=["callable", "list", "act", "predict", "flax", "flax-params", "flax-bound"],
)
def test_every_form_gives_the_same_actions(robot: Any) -> None:
    found = as_robot(robot)
    for _ in range(2):
        found.reset(4)
        np.testing.assert_allclose(found(OBS), 2.0 * OBS, rtol=1e-6)


def test_state_and_resets_arrive() -> None:
    acting, predicting = Acting(), as_robot(Predicting())
    as_robot(acting).reset(3)
    assert acting.rows == 3
    for _ in range(2):
        predicting.reset(4)
        for step in range(3):
            np.testing.assert_allclose(predicting(OBS), 2.0 * OBS + step)


@pytest.mark.parametrize("robot", [3, None, (1, 2), MODULE])
def test_what_is_no_robot_is_told_what_one_is(robot: Any) -> None:
    with pytest.raises(TypeError, match="is no robot; expected a callable from observations"):
        as_robot(robot)
