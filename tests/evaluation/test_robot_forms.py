"""Every form of robot answers alike, and is told when its episodes begin."""

from typing import Any

import jax.numpy as jnp
import ml_dtypes
import numpy as np
import pytest
from flax import linen

from evaluation.cast.egos import EgoError, call_ego
from evaluation.cast.robot_forms import as_robot
from evaluation.cast.roster import HostEgo


@pytest.fixture
def torch() -> Any:
    return pytest.importorskip("torch", reason="PyTorch, where it is installed")


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
    made = as_robot(robot)
    for _ in range(2):
        made.reset(4)
        np.testing.assert_allclose(made(OBS), 2.0 * OBS, rtol=1e-6)


def test_state_and_resets_arrive() -> None:
    acting, predicting = Acting(), as_robot(Predicting())
    as_robot(acting).reset(3)
    assert acting.rows == 3
    for _ in range(2):
        predicting.reset(4)
        for step in range(3):
            np.testing.assert_allclose(predicting(OBS), 2.0 * OBS + step)


@pytest.mark.parametrize("robot", [3, None, (1, 2), MODULE])
def test_unknown_form_error_lists_forms(robot: Any) -> None:
    with pytest.raises(TypeError, match="is not a robot; expected a callable from observations"):
        as_robot(robot)


def test_torch_module_evaluates_on_one_thread(torch: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    threads: list[int] = []

    class Net(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layers = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Dropout(0.5))

        def forward(self, obs: Any) -> Any:
            threads.append(torch.get_num_threads())
            return self.layers(obs.double())

    net, before = Net().double(), torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        robot = as_robot(net)
        first, second = robot(OBS), robot(OBS)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert first.shape == (4, 3) and threads == [1, 1]
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", ["act", "predict", "reset"])
def test_torch_layer_named_act_is_no_method(torch: Any, name: str) -> None:

    class Net(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            setattr(self, name, torch.nn.Tanh())

        def forward(self, obs: Any) -> Any:
            return getattr(self, name)(obs)

    robot = as_robot(Net())
    robot.reset(4)
    np.testing.assert_allclose(robot(OBS), np.tanh(OBS), rtol=1e-6)


def test_torch_module_with_act_is_evaluated(torch: Any) -> None:

    class Net(torch.nn.Module):
        def act(self, obs: np.ndarray) -> Any:
            return torch.nn.functional.dropout(torch.as_tensor(obs), 0.5, self.training)

    np.testing.assert_array_equal(as_robot(Net())(OBS), OBS)


def test_thread_setting_of_user_is_kept(torch: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        robot = as_robot(lambda obs: np.full((len(obs), 1), torch.get_num_threads()))
        assert robot(OBS)[0, 0] == 2
    finally:
        torch.set_num_threads(before)


class Narrow:
    """As a model of d3rlpy, whose `predict` takes observations alone."""

    def predict(self, x: np.ndarray) -> np.ndarray:
        return 2.0 * x


class Choosing:
    def predict(self, obs: np.ndarray, deterministic: bool = False) -> np.ndarray:
        assert deterministic
        return 2.0 * obs


def bfloat16(obs: np.ndarray) -> Any:
    return (2.0 * obs).astype(ml_dtypes.bfloat16)


def jax_rows(obs: np.ndarray) -> Any:
    return [jnp.asarray(2.0 * row) for row in obs]


@pytest.mark.parametrize(
    ("robot", "tolerance"),
    [
        (Narrow(), 0.0),
        (Choosing(), 0.0),
        (lambda obs: tuple(2.0 * obs), 0.0),
        (lambda obs: [list(row) for row in 2.0 * obs], 0.0),
        (jax_rows, 0.0),
        (bfloat16, 1e-2),
        (lambda obs: list(bfloat16(obs)), 1e-2),
        (lambda obs: jnp.asarray(2.0 * obs, jnp.bfloat16), 1e-2),
        (lambda obs: (2.0 * obs).astype(np.float16), 1e-3),
    ],
)
def test_answers_of_many_kinds_are_actions(robot: Any, tolerance: float) -> None:
    answer = as_robot(robot)(OBS)
    assert answer.dtype.kind == "f"
    np.testing.assert_allclose(answer, 2.0 * OBS, rtol=tolerance)
    if robot is bfloat16:
        np.testing.assert_array_equal(answer, bfloat16(OBS).astype(np.float32))


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (lambda obs: (obs, None), r"a tuple of 2 parts .*\(ndarray\[4, 2\], NoneType\); expected"),
        (lambda obs: (obs, {"value": 3}), r"a tuple of 2 parts .*ndarray\[4, 2\], dict\)"),
        (lambda obs: [[1.0, 2.0], [3.0]], r"a list of 2 parts .*list\[2\], list\[1\]"),
        (lambda obs: (obs, obs[:, :1]), r"a tuple of 2 parts .*ndarray\[4, 2\], ndarray\[4, 1\]"),
    ],
)
def test_several_things_are_no_actions(robot: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        as_robot(robot)(OBS)
    ego = HostEgo("m", robot)
    with pytest.raises(EgoError, match=message) as caught:
        call_ego(ego, ["a"], 4, 2)(OBS, 0)
    assert "robot_forms.py" not in str(caught.value)


def test_torch_answers_of_many_kinds_are_actions(torch: Any) -> None:
    weight = torch.full((1,), 2.0, requires_grad=True)
    for kind in (torch.bfloat16, torch.float16, torch.float64):
        answer = as_robot(lambda obs, kind=kind: (torch.tensor(obs) * weight).to(kind))(OBS)
        np.testing.assert_allclose(answer, 2.0 * OBS, rtol=1e-2)
    rows = as_robot(lambda obs: [torch.tensor(row) * weight for row in obs])(OBS)
    np.testing.assert_allclose(rows, 2.0 * OBS)
