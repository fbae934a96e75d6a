"""With the real evaluator: both formats, a private release, and values that do not move."""

import dataclasses
import json
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import polars as pl
import pytest

import assistax_envs
from assistax_board import submitting
from assistax_board.problems import Refusal
from assistax_board.robots.admission import Admission, robot_sizes
from assistax_board.rules.catalogue import PUBLIC_SEED, ZooCatalogue, panel_episodes, version_id
from assistax_board.rules.release_pack import hidden_partners, ordinal, pack
from assistax_board.rules.results import figures
from assistax_board.rules.scoring import Work, decode_table, encode_table, table_bytes

# Work that no server knows, as a trial at home makes it.
from assistax_board.submitting import _try_work
from assistax_board.work.zoo_scorer import ZooScorer
from assistax_envs import Env
from assistax_envs.preferences import PREFERENCES
from assistax_envs.versions import FUSED_VERSION
from evaluation.cast.cast import own_robots
from evaluation.cast.roster import registry_roster
from evaluation.figures.normalised import RANDOM, SCRIPT, SELF_PLAY, ZERO
from evaluation.play.baselines import reference_jobs, reference_roster
from evaluation.play.evaluator import run_job
from evaluation.play.how import PlaySettings
from evaluation.play.study import make_job
from population.networks.onnx_export import to_onnx
from population.networks.spec import PolicySpec
from population.runs.trained import TrainedTeam
from tests.board.fakes import draft, new_service, new_submitter
from tests.studies import evaluate_policies
from tests.untrained import (
    HUMAN,
    ROBOT,
    gentle_specs,
    params_of,
    published,
    teams_of,
    untrained_team,
)
from zoo.parameters.storage import policy_bytes
from zoo.registry import Registry, load_registry

TASK = "scratch"


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    return load_registry(published(teams_from(0), tmp_path_factory.mktemp("public")))


def teams_from(first: int, count: int = 3) -> list[TrainedTeam]:
    """Return untrained teams of d1 with these seeds."""
    return [
        untrained_team(
            "d1", seed, robot=(ROBOT, params_of(ROBOT, seed)), human=(HUMAN, params_of(HUMAN, seed))
        )
        for seed in range(first, first + count)
    ]


@pytest.fixture(autouse=True, scope="module")
def short_episodes() -> Iterator[None]:
    def short(*args: Any, **options: Any) -> Env:
        env = Env(*args, **options)
        env.episode_length = 100
        return env

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assistax_envs, "make", short)
        yield


def scorer_of(registry: Registry) -> ZooScorer:
    return ZooScorer(registry, ZooCatalogue(registry, "native"), "native")


def work(partners: tuple[str, ...]) -> Work:
    return _try_work(TASK, "safetensors", partners)


@pytest.mark.slow
def test_onnx_plays_bit_equal_at_home(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(submitting, "BACKEND", "native")
    spec, path = dataclasses.replace(ROBOT, torso="gru", hidden=(64, 64)), tmp_path / "robot.onnx"
    # Large and recurrent, so that another rounding would show within so few steps.
    params = jax.tree.map(lambda leaf: 4 * leaf, params_of(spec, 7))
    path.write_bytes(to_onnx(spec, params))
    table, score = _at_a_server(registry, path.read_bytes(), tmp_path / "server")

    checked = submitting.check_file(path, TASK, registry.path, whole=True)
    assert json.loads(json.dumps(checked["figures"])) == score
    assert (checked["partners"], checked["episodes"]) == (table["partner"].n_unique(), table.height)

    settings = PlaySettings(TASK, panel_episodes(TASK, "public"), PUBLIC_SEED, "native")
    played = evaluate_policies(registry, [path], settings, tmp_path / "home")
    assert played.m_test is not None
    home = pl.read_parquet(tmp_path / "home" / "episodes.parquet").sort("partner", "episode")
    for column in ("partner", "episode", "return", "success", "nonfinite"):
        assert home[column].equals(table[column]), column


def _at_a_server(
    registry: Registry, data: bytes, folder: Path
) -> tuple[pl.DataFrame, dict[str, Any]]:
    """Return what a server keeps of a file's public half: its episodes and its figures."""
    catalogue = ZooCatalogue(registry, "native")
    admission = Admission(robot_sizes(registry))
    service = dataclasses.replace(new_service(folder), catalogue=catalogue, admit=admission)
    id = service.submit(new_submitter(service), draft(data=data))
    scorer, tables = scorer_of(registry), []
    while work_item := service.lease("w", scorer.versions()):
        robot = service.artefacts.get(work_item.artefact)
        sent = encode_table(scorer.play(work_item, robot, None))
        asked = work_item.partners, work_item.episodes, work_item.preferences
        tables.append(decode_table(sent, *asked))
        service.result(work_item.job, work_item.lease, sent, 1.0)
    [score] = service.queries.scores(submission=id)
    return pl.concat(tables).sort("partner", "episode"), score.figures


def test_a_score_names_its_engine_and_episodes(registry: Registry) -> None:
    def found(backend: str) -> dict[str, Any]:
        return ZooCatalogue(registry, backend).identity(TASK)

    assert found("fused")["engine"] == {"name": "fused", "version": str(FUSED_VERSION)}
    assert found("native")["engine"] == {"name": "native", "version": version("mujoco")}
    assert "preferences" not in found("native")
    with pytest.raises(ValueError, match="backend is 'auto'; allowed"):
        found("auto")
    names = ("episodes", "hidden_episodes", "starts")
    assert [found("native")[name] for name in names] == [8, 16, "own"]
    gentle = [panel_episodes("gentle_scratch", panel) for panel in ("public", "A", "B")]
    assert gentle == [18, 18, 18], "each wish as often, of nine and of three"


# What decides a job's table, and what a version's identity calls it; None: the robot's own, or the
# same for every board.
DECIDES = {
    **{name: name for name in ("task", "env_version", "engine", "episodes", "seed", "preferences")},
    **{"evaluator_version": "evaluator", "backend": "engine", "software": "jax"},
    **{"partners": "panel", "apart": "starts", "scene": "env_version"},
    **dict.fromkeys(("egos", "stochastic", "paired", "series", "side_preferences")),
}


def test_version_covers_all_inputs_of_a_table(registry: Registry) -> None:
    """The board's identity is read without JAX, so it is a second one: the two must agree."""
    entries = registry.select(task=TASK, role="human")
    how, robots = PlaySettings(TASK, 8, 0, "native"), reference_roster(34, 7)
    _, job = make_job(how, robots, registry_roster(registry, entries))
    decided, version_of = job.identity(), ZooCatalogue(registry, "native").identity(TASK)
    assert decided.keys() <= DECIDES.keys(), "new: add it to the identity of a version, or say why"
    assert {name for name in DECIDES.values() if name} <= {*version_of, "preferences"}
    for name in ("task", "env_version", "engine", "episodes", "seed"):
        assert version_of[name] == decided[name]
    assert version_of["evaluator"] == decided["evaluator_version"]
    assert version_of["jax"] == decided["software"]["jax"]


@pytest.mark.slow
@pytest.mark.parametrize("reference", [None, ZERO, SELF_PLAY])
def test_private_release_is_played_under_ordinals(
    registry: Registry, tmp_path: Path, reference: str | None
) -> None:
    """References measure panel B; self-play is with the release's own robots."""
    private = load_registry(published(teams_from(100), tmp_path))
    packed, robot = pack(private.path.parent), policy_bytes(ROBOT, params_of(ROBOT, 7))
    asked = work((ordinal(1),))
    if reference is not None:
        asked = dataclasses.replace(asked, kind="reference", format=reference)
    hidden = scorer_of(registry).play(asked, None if reference else robot, packed)
    assert hidden["partner"].unique().to_list() == ["hidden-0001"]
    known = dataclasses.replace(asked, partners=(hidden_partners(private, TASK)[1].id,))
    shown = scorer_of(private).play(known, None if reference else robot, None)
    assert hidden["return"].equals(shown["return"])
    assert pack(private.path.parent) == packed


@pytest.mark.slow
def test_preferences_are_in_job_table_and_identity(tmp_path: Path) -> None:
    task = "gentle_scratch"
    robot, human = gentle_specs(task)
    registry = load_registry(published(teams_of(2, robot, human, task), tmp_path))
    identity = ZooCatalogue(registry, "native").identity(task)
    assert identity["preferences"] == list(PREFERENCES)
    assert version_id(identity) != version_id(identity | {"preferences": ["p1"]})
    partner = registry.select(task=task, role="human")[0].id
    work_item = dataclasses.replace(_try_work(task, "safetensors", (partner,)), episodes=9)
    file = policy_bytes(robot, params_of(robot, 7))
    table = scorer_of(registry).play(work_item, file, None)
    assert sorted(table["preference"]) == list(PREFERENCES), "each once in nine episodes"
    arrived = decode_table(encode_table(table), work_item.partners, 9, work_item.preferences)
    shown = figures(arrived)
    assert list(shown["by_preference"]) == list(PREFERENCES)
    assert 0.0 <= shown["caring_success"] == shown["success"] <= 1.0
    assert {"violations", "violations_impact", "failed_persons", "discomfort"} <= set(shown)
    assert {"liked_force", "done_speed", "within_speed"} <= set(arrived.columns)


@pytest.mark.slow
def test_reference_rows_are_what_evaluate_plays(registry: Registry, tmp_path: Path) -> None:
    """Its robots, its episodes, its numbers: `evaluation.play.baselines`."""
    partners = tuple(entry.id for entry in registry.select(task=TASK, role="human"))
    work_item = work(partners)
    entries = [registry.policy(name) for name in partners]
    settings = PlaySettings(TASK, work_item.episodes, int(work_item.seed, 16), "native")
    env, job = make_job(settings, reference_roster(34, 7), registry_roster(registry, entries))
    assert job.own_episodes, "as the identity of a version says"
    jobs = reference_jobs(env, job, own_robots(registry, entries))[:2]
    played = pl.concat(
        run_job(env, job, tmp_path / str(place)).table for place, job in enumerate(jobs)
    )
    egos = pl.col("ego"), pl.col("ego").str.starts_with(TASK)
    for name, chosen in ((RANDOM, egos[0] == RANDOM), (SELF_PLAY, egos[1])):
        reference = dataclasses.replace(work_item, kind="reference", format=name)
        table = scorer_of(registry).play(reference, None, None)
        expected = played.filter(chosen).sort("partner", "episode")
        assert table.sort("partner", "episode")["return"].equals(expected["return"])
        assert expected.height == table.height == 6


@pytest.mark.slow
def test_published_egos_are_rows_to_measure_by(registry: Registry, tmp_path: Path) -> None:
    rows = {ZERO: ZERO, RANDOM: RANDOM, SCRIPT: SCRIPT, SELF_PLAY: SELF_PLAY}
    assert ZooCatalogue(registry, "native").references(TASK) == rows
    team = untrained_team("mixed", 5, robot=(ROBOT, params_of(ROBOT, 5)))
    against = {"split": "scratch/half-s0-v0-01234567", "sha256": "0" * 64}
    ego = dataclasses.replace(team, algorithm="ppo", trained_against=against)
    teams = [*teams_from(0), ego]
    wider = load_registry(published(teams, tmp_path))
    assert ZooCatalogue(wider, "native").references(TASK) == rows | {"ppo-ego-s5-v0": "ppo ego"}
    partners = (next(entry.id for entry in wider.select(task=TASK, role="human")),)
    reference = dataclasses.replace(work(partners), kind="reference", format="ppo-ego-s5-v0")
    handed_in = policy_bytes(ROBOT, params_of(ROBOT, 5))
    tables = [
        scorer_of(wider).play(work_item, robot, None)
        for work_item, robot in ((reference, None), (work(partners), handed_in))
    ]
    assert table_bytes(tables[0]) == table_bytes(tables[1])


@pytest.mark.parametrize(
    ("spec", "code"),
    [
        (PolicySpec("human", 34, 7, hidden=(8,)), "wrong_role"),
        (PolicySpec("robot", 35, 7, hidden=(8,)), "wrong_sizes"),
        (PolicySpec("robot", 34, 6, hidden=(8,)), "wrong_sizes"),
    ],
)
def test_another_tasks_policy_is_refused(registry: Registry, spec: PolicySpec, code: str) -> None:
    with pytest.raises(Refusal) as refusal:
        Admission(robot_sizes(registry))(policy_bytes(spec, params_of(spec, 0)), TASK)
    assert refusal.value.code == code
