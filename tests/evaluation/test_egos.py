import sys
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np
import pytest

from assistax_base.errors import ZooError
from evaluation.cast.egos import EgoError, call_ego, probe_egos, read_egos
from evaluation.cast.roster import HostEgo
from population.networks.stack import PolicyStack
from tests.untrained import ROBOT, params_of
from zoo.parameters.storage import write_policy_file
from zoo.registry import Registry

EMPTY = Registry(data=cast(Any, None), path=Path("registry.json"), policies=[])
PARTNERS = ("t/a-d1-s0-v0/human", "t/a-d1-s1-v0/human")


def ask(answer: Any) -> np.ndarray:
    ego = HostEgo("python:m:f", lambda obs: answer)
    act = call_ego(ego, PARTNERS, episodes=2, action_size=2)
    return act(np.zeros((4, 3), np.float32), 7)


def test_files_of_one_spec_are_stacked_in_order(tmp_path: Path):
    paths = [str(tmp_path / f"{i}.safetensors") for i in range(2)]
    params = [params_of(ROBOT, seed) for seed in range(2)]
    for path, leaves in zip(paths, params, strict=True):
        write_policy_file(path, ROBOT, leaves)
    egos = read_egos(paths, EMPTY, "scratch")
    [stack] = egos.stacks
    assert isinstance(stack, PolicyStack)
    assert list(stack.ids) == list(egos.members) == paths
    assert len({member.digest for member in egos.members.values()}) == 2
    expected = jax.tree.map(lambda *rows: np.stack(rows), *params)
    jax.tree.map(np.testing.assert_array_equal, stack.params, expected)


def test_glob_sorts_files_by_seed(tmp_path: Path):
    paths = [str(tmp_path / f"ppo-s{seed}.safetensors") for seed in (0, 2, 10)]
    for path in paths:
        write_policy_file(path, ROBOT, params_of(ROBOT, len(path)))
    glob = str(tmp_path / "*.safetensors")
    assert list(read_egos([glob], EMPTY, "scratch").members) == paths
    with pytest.raises(ValueError, match=r"x\*.safetensors.* matches no file"):
        read_egos([str(tmp_path / "x*.safetensors")], EMPTY, "scratch")
    Path(glob).write_bytes(Path(paths[0]).read_bytes())  # a file that is so called is meant
    assert list(read_egos([glob], EMPTY, "scratch").members) == [glob]


def test_missing_files_are_reported(tmp_path: Path):
    with pytest.raises(ZooError, match="no such file"):
        read_egos([str(tmp_path / "none.safetensors")], EMPTY, "scratch")
    with pytest.raises(ValueError, match=r"none.onnx.*no file"):
        read_egos([f"onnx:{tmp_path / 'none.onnx'}"], EMPTY, "scratch")


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("scratch/ippo-d1-s0-v0/robot", "is of task scratch, not of bed_bath; .* or play scratch"),
        ("bed_bath/ippo-d1-s0-v0/human", "is a human, not a robot; .* bed_bath/.*-v0/robot"),
        ("zero", "is not a robot to evaluate"),
    ],
)
def test_unplayable_reference_error_has_reason(reference: str, message: str):
    with pytest.raises(ValueError, match=message):
        read_egos([reference], EMPTY, "bed_bath")


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "my_robot_under_test.py").write_text(
        "import numpy as np\n"
        "def zero():\n    return lambda obs: np.zeros((len(obs), 7))\n"
        "def broken():\n    raise KeyError('weights')\n"
        "def wrong():\n    return 3\n"
        "number = 5\n"
        "def dropout():\n"
        "    from flax import nnx\n"
        "    layer = nnx.Dropout(0.5, rngs=nnx.Rngs(0))\n"
        "    return lambda obs: layer(obs[:, :7])\n"
    )
    (tmp_path / "unimportable_robot.py").write_text("import surely_not_installed_anywhere\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "my_robot_under_test", raising=False)
    return "my_robot_under_test"


def test_factory_of_working_folder_is_found(module: str):
    for name, action in (("zero", 0.0), ("dropout", 1.0)):  # which plays without training
        egos = read_egos([f"python:{module}:{name}"], EMPTY, "scratch")
        (ego,) = egos.stacks
        assert isinstance(ego, HostEgo) and egos.members[ego.id].team is None
        assert ego.id == f"python:{module}:{name}"
        assert np.array_equal(ego.act(np.ones((4, 34), np.float32)), np.full((4, 7), action))


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("python:my_robot_under_test", "lacks a part; expected python:package.module:factory"),
        ("python:my_robot_under_test.py:", "lacks a part; expected .*python:FILE.py:factory"),
        ("python:my_robot_under_test:zero?x", "unreadable arguments"),
        ("python:no_such_module_here:f", "cannot import no_such_module_here: ModuleNotFoundError"),
        ("python:unimportable_robot:f", "surely_not_installed_anywhere"),
        ("python:my_robot_under_test:number", "has no function 'number'"),
        ("python:my_robot_under_test:broken", r"failed: KeyError: 'weights' \(my_.*test.py:5\)"),
        ("python:my_robot_under_test:wrong", r"wrong\(\) returned int; expected a callable"),
    ],
)
def test_a_bad_factory_gets_one_line(module: str, reference: str, message: str):
    with pytest.raises(ValueError, match=message) as caught:
        read_egos([reference], EMPTY, "scratch")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (lambda obs: obs @ np.zeros((30, 7)), "failed: ValueError: matmul"),
        (lambda obs: np.zeros((len(obs), 3)), r"returned float64 of shape \(2, 3\)"),
        (lambda obs: sys.exit("two\nlines"), r"failed: SystemExit: two lines \(test_egos.py:\d+\)"),
    ],
)
def test_unfit_robot_error_has_sizes_and_task(robot: Any, message: str):
    sizes = r"robot of task scratch reads observations \[N, 34\] and gives actions \[N, 7\]"
    with pytest.raises(EgoError, match=f"given two rows of zeros it {message}.*{sizes}"):
        probe_egos(read_egos([robot], EMPTY, "scratch"), "scratch", 34, 7)


def test_probe_resets_robot_before_and_after():
    class Robot:
        told: list[int] = []  # noqa: RUF012

        def reset(self, rows: int) -> None:
            self.told.append(rows)

        def act(self, obs: np.ndarray) -> np.ndarray:
            self.told.append(-len(obs))
            return np.full((len(obs), 7), np.nan)  # what zeros are to it need not be an action

    probe_egos(read_egos([Robot()], EMPTY, "scratch"), "scratch", 34, 7)
    assert Robot.told == [2, -2, 2]


@pytest.mark.parametrize(
    "answer", [np.zeros((4, 3)), np.zeros(4), np.zeros((2, 4, 2)), [["a", "b"]] * 4, None]
)
def test_wrong_answer_error_has_expected_shape(answer: Any):
    with pytest.raises(EgoError, match=r"s0.* to .*s1.*, step 7: .*expected .*\(4, 2\)"):
        ask(answer)


def test_nan_error_names_partner_and_episode():
    answer = np.zeros((4, 2))
    answer[3, 1] = np.nan
    words = rf"{PARTNERS[1]}, step 7: .* episode 1 is not finite \(1 of"
    with pytest.raises(EgoError, match=words):
        ask(answer)
