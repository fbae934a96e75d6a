"""Networks play in evaluation mode, and come back with all modes, statistics and chance."""

import contextlib
import copy
import functools
import random
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest
from flax import nnx

from evaluation.cast.egos import probe_egos
from evaluation.cast.robot_forms import as_robot
from evaluation.play.evaluator import run_job
from evaluation.play.jobs import Job
from tests.evaluation.matrix_game import MatrixGame, host, humans

OBS = np.linspace(-1.0, 3.0, 8, dtype=np.float32).reshape(4, 2)


class FlaxNet(nnx.Module):
    def __init__(self, rngs: nnx.Rngs) -> None:
        self.layer = nnx.Linear(2, 7, rngs=rngs)
        self.normed = nnx.BatchNorm(7, rngs=rngs)
        self.dropouts = nnx.List([nnx.Dropout(0.5, rngs=rngs)])
        self.frozen = nnx.Dropout(0.5, deterministic=True, rngs=rngs)

    def __call__(self, obs: Any) -> Any:
        return self.frozen(self.dropouts[0](self.normed(self.layer(obs))))


class Acting:
    def __init__(self, net: Any) -> None:
        self.nets = {"robot": [net]}

    def act(self, obs: np.ndarray) -> Any:
        return self.nets["robot"][0](obs)


GLOBAL_NET: Any = None
WRAPPINGS: dict[str, Callable[[Any], Any]] = {
    "itself": lambda net: net,
    "closure": lambda net: lambda obs: net(obs),
    "global": lambda net: lambda obs: GLOBAL_NET(obs),
    "attribute": Acting,
    "partial": lambda net: functools.partial(lambda net, obs: net(obs), net),
    "method": lambda net: Acting(net).act,
}


def flax_state(net: nnx.Module) -> Any:
    """Return all that training goes on from: modes, and every variable's value."""
    modes = [
        (path, {name: value for name, value in vars(part).items() if isinstance(value, bool)})
        for path, part in nnx.iter_modules(net)
    ]
    leaves = jax.tree.leaves(nnx.state(net))
    is_key = [jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key) for leaf in leaves]
    values = [jax.random.key_data(x) if key else x for x, key in zip(leaves, is_key, strict=True)]
    return modes, [np.asarray(value).tolist() for value in values]


@pytest.mark.parametrize("wrapping", WRAPPINGS)
def test_a_flax_network_plays_without_training(
    wrapping: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    net = FlaxNet(nnx.Rngs(0))
    monkeypatch.setitem(globals(), "GLOBAL_NET", net)
    twin = FlaxNet(nnx.Rngs(0))
    twin.eval()
    expected, before = np.asarray(twin(OBS)), flax_state(net)
    assert not np.allclose(copy.deepcopy(net)(OBS), expected)  # as it trains
    np.testing.assert_allclose(as_robot(WRAPPINGS[wrapping](net))(OBS), expected, rtol=1e-6)
    assert flax_state(net) == before


@pytest.mark.parametrize("fails", [False, True])
def test_a_flax_network_that_draws_comes_back(fails: bool) -> None:
    net = FlaxNet(nnx.Rngs(0))
    drawing = nnx.Dropout(0.5, rngs=nnx.Rngs(1))

    def act(obs: np.ndarray) -> Any:
        drawing.deterministic = False  # as an exploring robot does
        return drawing(net(obs))

    before, counts = flax_state(net), flax_state(drawing)
    robot = as_robot(act)
    with contextlib.suppress(ZeroDivisionError), robot.playing():
        assert not np.array_equal(robot(OBS), robot(OBS))  # chance goes on within a play
        if fails:
            raise ZeroDivisionError
    assert (flax_state(net), flax_state(drawing)) == (before, counts)


def test_global_generators_are_restored_after_play(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = as_robot(lambda obs: np.random.normal(size=(len(obs), 7)) + random.random())
    restored: list[Any] = []  # beartype, which checks calls in tests, draws from it too
    monkeypatch.setattr(random, "setstate", restored.append)
    np.random.seed(4)
    before, state = random.getstate(), np.random.get_state()
    with robot.playing():
        assert not np.array_equal(robot(OBS), robot(OBS))
    assert str(np.random.get_state()) == str(state)
    assert [len(one) for one in restored] == [len(before)]


def test_generators_of_a_robot_come_back() -> None:
    class Drawing:
        def __init__(self) -> None:
            self.new, self.old = np.random.default_rng(0), np.random.RandomState(0)
            self.plain = random.Random(0)

        def act(self, obs: np.ndarray) -> np.ndarray:
            return self.new.normal(size=(len(obs), 7)) + self.old.normal() + self.plain.random()

    net = Drawing()
    robot = as_robot(net)
    with robot.playing():
        first, second = robot(OBS), robot(OBS)
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(net.act(OBS), first)


def test_a_network_comes_back_from_a_job(tmp_path: Any) -> None:
    dropout: Any = nnx.Dropout(0.5, rngs=nnx.Rngs(0))

    def act(obs: np.ndarray) -> Any:
        modes.append(dropout.deterministic)
        dropout.rngs()  # draws in the thread that plays
        return dropout(obs[:, :2])

    modes: list[bool] = []
    before = flax_state(dropout)
    probe_egos(host(act), "scratch", 2, 2)
    assert flax_state(dropout) == before
    job = Job("matrix", 1, "mjx", host(act), humans(-0.5, 0.5), episodes=2)
    run_job(MatrixGame(), job, tmp_path)
    assert set(modes) == {True} and flax_state(dropout) == before


def test_linen_network_is_in_evaluation_mode() -> None:
    from flax import linen

    class Net(linen.Module):
        @linen.compact
        def __call__(self, obs: Any, train: bool = True) -> Any:
            obs = linen.BatchNorm(use_running_average=not train)(obs)
            return linen.Dropout(0.5, deterministic=not train)(obs)

    module = Net()
    variables = module.init(jax.random.key(0), OBS, train=False)
    for robot in ((module, variables), module.bind(variables)):
        np.testing.assert_allclose(as_robot(robot)(OBS), OBS, rtol=1e-4)


@pytest.fixture
def torch() -> Any:
    return pytest.importorskip("torch", reason="PyTorch, where it is installed")


def torch_state(net: Any) -> Any:
    values = {name: value.tolist() for name, value in net.state_dict().items()}
    return [part.training for part in net.modules()], values


def torch_net(torch: Any) -> Any:
    torch.manual_seed(0)
    net = torch.nn.Sequential(
        torch.nn.Linear(2, 7),
        torch.nn.BatchNorm1d(7),
        torch.nn.Sequential(torch.nn.Dropout(0.5), torch.nn.BatchNorm1d(7)),
    )
    net[2][1].eval()  # frozen while the others train
    return net


@pytest.mark.parametrize("wrapping", WRAPPINGS)
def test_a_torch_module_plays_without_training(
    wrapping: str, torch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    net = torch_net(torch)
    expected = copy.deepcopy(net).eval()(torch.tensor(OBS)).detach().numpy()
    called = net if wrapping == "itself" else lambda obs: net(torch.as_tensor(obs))
    monkeypatch.setitem(globals(), "GLOBAL_NET", called)
    before, chance = torch_state(net), torch.get_rng_state()
    robot = as_robot(WRAPPINGS[wrapping](called))
    np.testing.assert_allclose(robot(OBS), expected, rtol=1e-6)
    assert torch_state(net) == before
    assert torch.equal(torch.get_rng_state(), chance)


def test_torch_buffers_and_generators_are_restored(torch: Any) -> None:
    class Net(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layer = torch.nn.Linear(2, 7)
            self.register_buffer("replaced", torch.zeros(1))
            self.register_buffer("counted", torch.zeros(1))
            self.drawing = torch.Generator()

        def forward(self, obs: Any) -> Any:
            self.replaced = self.replaced + 1
            self.counted += 1
            noise = torch.randn(len(obs), 7, generator=self.drawing) + torch.randn(1)
            return self.layer(obs) + noise

    net, optimised = Net(), torch.ones(1)
    before, chance = torch_state(net), torch.get_rng_state()
    drawing = net.drawing.get_state()
    robot = as_robot(net)
    with robot.playing():
        assert not np.array_equal(robot(OBS), robot(OBS))
    assert torch_state(net) == before and torch.equal(torch.get_rng_state(), chance)
    assert torch.equal(net.drawing.get_state(), drawing)
    (net.layer(torch.tensor(OBS)).sum() + (net.replaced * optimised).sum()).backward()  # trains on


def test_merged_module_is_split_again(torch: Any) -> None:
    class Merging(torch.nn.Module):
        """As an adapter of low rank, which adds its product to the weight when training ends."""

        def __init__(self) -> None:
            super().__init__()
            self.layer, self.added = torch.nn.Linear(2, 7), torch.nn.Parameter(torch.ones(7, 2))

        def train(self, mode: bool = True) -> Any:
            if mode != self.training:
                self.layer.weight.data += -self.added.data if mode else self.added.data
            return super().train(mode)

        def forward(self, obs: Any) -> Any:
            return self.layer(obs)

    net = Merging()
    weight = net.layer.weight.detach().clone()
    as_robot(net)(OBS)
    assert net.training and torch.allclose(net.layer.weight, weight, atol=1e-6)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        (["float64"], "float64"),
        (["bfloat16"], "bfloat16"),
        (["float16", "int8"], "float16"),
        (["int8"], "float32"),
        (["float64", "float32"], "float32"),
        ([], "float32"),
    ],
)
def test_torch_module_gets_its_float_type(torch: Any, parameters: list[str], expected: str) -> None:
    class Net(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            values = [torch.ones(1, dtype=getattr(torch, name)) for name in parameters]
            self.values = torch.nn.ParameterList(torch.nn.Parameter(v, False) for v in values)

        def forward(self, obs: Any) -> Any:
            seen.append(obs.dtype)
            return obs

    seen: list[Any] = []
    answer = as_robot(Net())(OBS)
    assert seen == [getattr(torch, expected)]
    np.testing.assert_allclose(answer, OBS, rtol=1e-2)
