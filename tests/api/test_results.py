"""Evaluations and cross-plays from Python: typed figures, tables, pages and figures of them."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import assistax_zoo as az
from assistax_base.errors import RemoteError
from evaluation import evaluate as study
from evaluation.cast.robot_forms import as_robot
from evaluation.play import evaluator
from evaluation.record import tables
from population.networks.onnx_export import to_onnx
from tests import untrained
from tests.untrained import HUMAN, ROBOT, params_of
from zoo.parameters.storage import write_policy_file

STEPS = 20


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> az.Zoo:
    path = untrained.published(untrained.teams_of(4), tmp_path_factory.mktemp("zoo"))
    return az.open_zoo(path.parent)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", STEPS)


def told(figure: Any) -> Any:
    """Return a figure that must be there."""
    assert figure is not None
    return figure


def evaluate(robot: Any, zoo: az.Zoo, **options: Any) -> az.EvaluationResult:
    options = {"episodes": 1, "backend": "native", "references": False, **options}
    return az.evaluate(robot, task="scratch", zoo=zoo, progress=False, **options)


@pytest.fixture(scope="module")
def result(zoo: az.Zoo) -> az.EvaluationResult:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assistax_envs.env.EPISODE_LENGTH", STEPS)
        return evaluate(lambda obs: np.zeros((len(obs), 7)), zoo, split="both", episodes=2)


def test_a_zoo_is_listed_and_its_partners_act(zoo: az.Zoo) -> None:
    assert len(zoo.list(role="human")) == 8
    assert zoo.list("scratch/ippo-d9-*/robot", task="scratch")[0] == "scratch/ippo-d9-s0-v0/robot"
    partner = zoo.partner("scratch/ippo-d9-s1-v0")
    assert (partner.id, partner.spec) == ("scratch/ippo-d9-s1-v0/human", HUMAN)
    assert partner.setting == zoo.select(partner.id)[0].setting
    assert partner.card is not None and partner.card.seed == 1
    partner.reset(5)
    obs = np.zeros((5, HUMAN.observation_size), np.float32)
    assert partner.act(obs).shape == (5, HUMAN.action_size)
    assert zoo.partner("scratch/ippo-d9-s1-v0", role="robot").spec == ROBOT
    assert "8 + 8" not in repr(zoo) and "16 policies" in repr(zoo)


def test_a_result_has_figures_and_tables(result: az.EvaluationResult, tmp_path: Path) -> None:
    figures = result.to_json()
    assert told(result.m_test).mean == figures["m_test"]["mean"] and told(result.m_test).n == 4
    assert told(result.gap).n == 8 and list(result.by_disability) == ["d1", "d9"]
    assert result.episodes.height == 16 and result.partners.height == 8
    assert result.worst_partner.partner.startswith("scratch/ippo-")
    assert repr(result).startswith("EvaluationResult(scratch: M_test ")
    assert "<table" in result._repr_html_() and "M_train" in result._repr_html_()
    for kind in ("zsc", "disability", "profile"):
        result.plot(tmp_path / f"{kind}.png", kind)
        assert (tmp_path / f"{kind}.png").read_bytes()[:4] == b"\x89PNG"
    page = result.report(tmp_path / "mine.html").read_text()
    assert "Zero-shot evaluation: scratch" in page


def test_a_saved_result_is_loaded_and_compared(
    result: az.EvaluationResult, zoo: az.Zoo, tmp_path: Path
) -> None:
    saved = result.save(tmp_path / "still")
    with pytest.raises(FileExistsError, match="still exists"):
        result.save(saved)
    again = az.load_result(saved)
    assert isinstance(again, az.EvaluationResult) and again.summary == result.summary
    moving = evaluate(lambda obs: np.ones((len(obs), 7)), zoo, split="both", episodes=2)
    comparison = az.compare(moving, saved)
    difference = told(moving.m_test).mean - told(result.m_test).mean
    assert told(comparison.test).mean == pytest.approx(difference)
    assert repr(comparison).startswith("Comparison(scratch: test partners ")
    other = evaluate(lambda obs: np.ones((len(obs), 7)), zoo, episodes=1)
    with pytest.raises(ValueError, match="episodes_per_pair is 1"):
        az.compare(other, saved)


@pytest.mark.slow
def test_two_results_in_one_folder(zoo: az.Zoo, tmp_path: Path) -> None:
    """The second replaces the first if that is asked for, and the first then answers no more."""
    options: dict[str, Any] = {"out": tmp_path / "C", "split": "both"}
    first = evaluate(lambda obs: np.zeros((len(obs), 7)), zoo, episodes=2, **options)
    apart = evaluate(lambda obs: np.ones((len(obs), 7)), zoo, split="both")

    def again(**more: Any) -> az.EvaluationResult:
        return evaluate(lambda obs: np.ones((len(obs), 7)), zoo, **options, **more)

    for reuse in (False, True):
        with pytest.raises(ValueError, match=r"episodes 2 there, 1 here.*or replace it"):
            again(reuse=reuse)
    with pytest.raises(ValueError, match="choose one"):
        again(reuse=True, replace=True)
    assert first.episodes.height == 16
    second = again(replace=True)
    assert told(second.m_test).mean == told(apart.m_test).mean != told(first.m_test).mean
    assert az.compare(apart, second).test == az.compare(apart, apart).test
    for answer in (
        lambda: az.compare(first, second),
        lambda: first.episodes,
        lambda: first.partners,
        lambda: first.report(tmp_path / "page.html"),
        lambda: first.plot(tmp_path / "zsc.png"),
        lambda: first.save(tmp_path / "saved"),
    ):
        with pytest.raises(ValueError, match="no longer holds this result"):
            answer()
    assert first.to_json()["m_test"]["mean"] == told(first.m_test).mean
    with pytest.raises(ValueError, match="still the same robot"):
        again()
    assert again(reuse=True).episodes.equals(second.episodes)


def test_replaced_job_draws_nothing(
    zoo: az.Zoo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process gives the folder to another job while this one plays its references."""
    run = study.run_job

    def replaced(env: Any, job: Any, folder: Path, **options: Any) -> Any:
        result = run(env, job, folder, **options)
        evaluator.delete_results(folder)
        run(env, dataclasses.replace(job, seed=1), folder)
        return result

    monkeypatch.setattr(study, "run_job", replaced)
    with pytest.raises(ValueError, match="was replaced while this command ran"):
        evaluate("scratch/ippo-d1-s0-v0/robot", zoo, out=tmp_path)
    assert not (tmp_path / tables.SUMMARY_FILE).exists()


@pytest.mark.slow
def test_missing_policy_is_named_or_fetched(
    zoo: az.Zoo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wheel has no shards; those of the robot and of the references are fetched too."""
    bare, robot = tmp_path / "bare" / "registry.json", "scratch/ippo-d1-s0-v0/robot"
    bare.parent.mkdir()
    bare.write_bytes(zoo.registry.path.read_bytes())
    monkeypatch.setenv("ASSISTAX_ZOO_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", str(zoo.registry.path.parent))
    with pytest.raises(RemoteError, match=r"5 of 5 policies.* 2 shards missing.*fetch them before"):
        evaluate(robot, az.open_zoo(bare))
    with pytest.raises(RemoteError, match=r"8 of 8 policies.* 2 shards missing"):
        evaluate(lambda obs: obs[:, :7], az.open_zoo(bare), references=True)
    result = evaluate(robot, az.open_zoo(bare), fetch=True)
    assert told(result.m_test).mean == told(evaluate(robot, zoo).m_test).mean


def test_temporary_folder_lives_as_long_as_result(zoo: az.Zoo) -> None:
    result = evaluate("scratch/ippo-d1-s0-v0/robot", zoo)
    folder = result.folder
    assert (folder / tables.EPISODES_FILE).is_file()
    del result
    assert not folder.exists()


@pytest.mark.slow
def test_every_form_of_one_robot_earns_the_same(zoo: az.Zoo, tmp_path: Path) -> None:
    """A policy file, its ONNX export, a callable, a Partner and an SB3-like model: one network."""
    params = params_of(ROBOT, 33)  # of no robot of the zoo, whose own human would be left out
    write_policy_file(tmp_path / "mine.safetensors", ROBOT, params)
    (tmp_path / "mine.onnx").write_bytes(to_onnx(ROBOT, params))
    partner = zoo.partner("scratch/ippo-d1-s0-v0", role="robot")
    own = type(partner)("mine", ROBOT, params)

    class Predicting:
        def predict(self, obs: Any, state: Any, episode_start: Any, deterministic: bool) -> Any:
            return own.act(obs), None

    files = [tmp_path / "mine.safetensors", str(tmp_path / "mine.onnx")]
    robots = [*files, own, lambda obs: own.act(obs), Predicting()]
    returns = [told(evaluate(robot, zoo).m_test).mean for robot in robots]
    np.testing.assert_allclose(returns, returns[0], rtol=1e-3)
    assert as_robot(own)(np.zeros((2, 34), np.float32)).shape == (2, 7)


def test_a_list_are_seeds_of_one_method(zoo: az.Zoo) -> None:
    result = evaluate([f"scratch/ippo-d1-s{seed}-v0/robot" for seed in (0, 1)], zoo)
    # Each robot's own human is left out: 3 of the 4 partners.
    assert told(result.m_test).n == 2 * 3 and len(result.summary.egos) == 2


@pytest.mark.slow
def test_a_crossplay_clusters_and_draws(zoo: az.Zoo, tmp_path: Path) -> None:
    teams = "scratch/ippo-d?-s[01]-v0"
    globs = f"{teams}/robot", f"{teams}/human"
    options: dict[str, Any] = {"episodes": 1, "backend": "native", "progress": False, "seed": 5}
    result = az.cross_play(*globs, task="scratch", zoo=zoo, **options)
    film = "assistax-zoo render --task scratch --seed 5"  # though nobody typed a seed
    assert film in result.report(tmp_path / "xp.html").read_text()
    assert result.pairs.height == 16 and told(result.self_play).n == 4
    result.plot(tmp_path / "xp.png")
    assert (tmp_path / "xp.png").stat().st_size > 1000
    assert "self-play" in repr(result) and "self-play" in result._repr_html_()
    assert json.loads((result.folder / "run.json").read_text())["command"]
