"""With the real evaluator: both formats, a private release, and values that do not move."""

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_envs.versions import FUSED_VERSION
from assistax_zoo.service import zoo_scorer
from assistax_zoo.service.admission import Admission, robot_sizes
from assistax_zoo.service.catalogue import ZooCatalogue
from assistax_zoo.service.problems import Refusal
from assistax_zoo.service.release_pack import hidden_partners, ordinal, pack
from assistax_zoo.service.scoring import Work, encode_table
from assistax_zoo.service.submitting import _try_work
from assistax_zoo.service.zoo_scorer import ZooScorer
from population.onnx_export import to_onnx
from population.spec import PolicySpec
from tests.untrained import HUMAN, ROBOT, params_of, published, untrained_team
from zoo.registry import Registry, load_registry
from zoo.storage import write_policy_file

TASK = "scratch"


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    return _registry(tmp_path_factory.mktemp("public"), first=0)


def _registry(folder: Path, first: int) -> Registry:
    teams = [
        untrained_team(
            "d1", seed, robot=(ROBOT, params_of(ROBOT, seed)), human=(HUMAN, params_of(HUMAN, seed))
        )
        for seed in range(first, first + 3)
    ]
    return load_registry(published(teams, folder))


@pytest.fixture
def files(tmp_path: Path) -> dict[str, bytes]:
    """One robot in both formats."""
    params, path = params_of(ROBOT, 7), tmp_path / "robot.safetensors"
    write_policy_file(path, ROBOT, params)
    return {"safetensors": path.read_bytes(), "onnx": to_onnx(ROBOT, params)}


@pytest.fixture(autouse=True, scope="module")
def short_episodes() -> Iterator[None]:
    env = zoo_scorer._env(TASK, "native")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(env, "episode_length", 100)
        yield


def scorer_of(registry: Registry) -> ZooScorer:
    return ZooScorer(registry, ZooCatalogue(registry, "native"), "native")


def work(partners: tuple[str, ...]) -> Work:
    return _try_work(TASK, "safetensors", partners)


def test_a_robot_scores_the_same_in_both_formats_and_every_time(
    registry: Registry, files: dict[str, bytes]
) -> None:
    partners = tuple(entry.id for entry in registry.select(task=TASK, role="human"))
    tables = [
        scorer_of(registry).play(work(partners), files[format], None)
        for format in ("safetensors", "safetensors", "onnx")
    ]
    assert encode_table(tables[0]) == encode_table(tables[1])
    returns = [table.sort("partner", "episode")["return"].to_numpy() for table in tables]
    # The networks round differently in the last bit, and contacts amplify that.
    np.testing.assert_allclose(returns[0], returns[2], rtol=0.05, atol=1.0)


def test_a_score_names_the_engine_that_made_it(registry: Registry) -> None:
    def found(backend: str) -> dict[str, str]:
        return ZooCatalogue(registry, backend).identity(TASK)["engine"]

    assert found("fused") == {"name": "fused", "version": str(FUSED_VERSION)}
    assert found("native") == {"name": "native", "version": version("mujoco")}
    with pytest.raises(ValueError, match="backend is 'auto'; allowed"):
        found("auto")


def test_a_private_release_is_played_under_ordinals(
    registry: Registry, files: dict[str, bytes], tmp_path: Path
) -> None:
    private = _registry(tmp_path, first=100)
    packed = pack(private.path.parent)
    humans = hidden_partners(private, TASK)
    hidden = scorer_of(registry).play(work((ordinal(1),)), files["safetensors"], packed)
    assert hidden["partner"].unique().to_list() == ["hidden-0001"]
    shown = scorer_of(private).play(work((humans[1].id,)), files["safetensors"], None)
    assert hidden["return"].equals(shown["return"])
    assert pack(private.path.parent) == packed


def test_a_live_robot_is_a_callable(registry: Registry) -> None:
    partners = tuple(entry.id for entry in registry.select(task=TASK, role="human"))[:1]
    live: dict[str, Any] = {**vars(work(partners)), "kind": "live"}
    table = scorer_of(registry).play(
        Work(**live), lambda obs: np.zeros((len(obs), 7), np.float32), None
    )
    assert isinstance(table, pl.DataFrame)
    assert table.height == 2


def test_admission_reads_both_formats(registry: Registry, files: dict[str, bytes]) -> None:
    admission = Admission(robot_sizes(registry))
    assert [admission(files[name], TASK) for name in files] == ["safetensors", "onnx"]


@pytest.mark.parametrize(
    ("spec", "code"),
    [
        (PolicySpec("human", 34, 7, hidden=(8,)), "wrong_role"),
        (PolicySpec("robot", 35, 7, hidden=(8,)), "wrong_sizes"),
        (PolicySpec("robot", 34, 6, hidden=(8,)), "wrong_sizes"),
    ],
)
def test_another_tasks_policy_is_refused(
    registry: Registry, tmp_path: Path, spec: PolicySpec, code: str
) -> None:
    write_policy_file(tmp_path / "p.safetensors", spec, params_of(spec, 0))
    with pytest.raises(Refusal) as refusal:
        Admission(robot_sizes(registry))((tmp_path / "p.safetensors").read_bytes(), TASK)
    assert refusal.value.code == code


@pytest.mark.parametrize("seed", range(100))
def test_home_and_server_agree_on_good_and_damaged_files(
    registry: Registry, files: dict[str, bytes], seed: int
) -> None:
    """Two hundred files: the answer is a format or a word, and always the same."""
    rng = np.random.default_rng(seed)
    for data in files.values():
        damaged = bytearray(data)
        for place in rng.integers(0, len(data), rng.integers(0, 4)):
            damaged[place] = rng.integers(256)
        home, server = (_answer(registry, bytes(damaged)) for _ in "hs")
        assert home == server


def _answer(registry: Registry, data: bytes) -> str:
    try:
        return Admission(robot_sizes(registry))(data, TASK)
    except Refusal as refusal:
        return refusal.code
