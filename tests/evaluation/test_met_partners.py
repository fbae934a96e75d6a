"""Training partners of robots: records, notes, and figures of new partners without them."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars as pl
import pytest

import assistax_zoo as az
from assistax_base.errors import SplitError, UnknownIdError
from assistax_board.rules.catalogue import ZooCatalogue
from assistax_workshop.press.publish import publish
from evaluation.cast.egos import EgoError, read_egos
from evaluation.cast.met_partners import MetPartners, MetSummary, declare, met_partners
from evaluation.crossplay import cast_population
from evaluation.record import tables
from evaluation.record.manifest import read_manifest
from population.runs.trained import TrainedTeam
from tests.untrained import HUMAN, ROBOT, params_of, published, teams_of, untrained_team
from zoo.exports.policies import Format, export_policy
from zoo.met.published import Met, met_in_training
from zoo.parameters.storage import read_policy_file, write_policy_file
from zoo.registry import Registry, load_registry
from zoo.saving import save_registry
from zoo.schema import TrainedAgainst
from zoo.splitting.rules import make_split

TASK, EGO, D1 = "scratch", "scratch/ppo-ego-s0-v0/robot", "without-d1"


def trained_ego(seed: int, against: dict[str, str]) -> TrainedTeam:
    team = untrained_team("mixed", seed, robot=(ROBOT, params_of(ROBOT, 50 + seed)))
    return dataclasses.replace(team, algorithm="ppo", trained_against=against)


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    """Four teams of d1 and of d9, two splits, and three egos.

    The egos were trained with the training sides of the two splits and of a missing split.
    """
    path = published(teams_of(4), tmp_path_factory.mktemp("zoo"))
    data = load_registry(path).data
    options: dict[str, Any] = {"rule": "leave-one-disability-out", "held_out": "d1"}
    split = make_split(data.teams, task=TASK, release="v0", **options)
    save_registry(data.model_copy(update={"splits": (*data.splits, split)}), path)
    half = load_registry(path).split(TASK)
    named = [{"split": entry.id, "sha256": entry.sha256} for entry in (half, split)]
    lost = {"split": "scratch/half-s7-v0-01234567", "sha256": "0" * 64}
    egos = [trained_ego(seed, against) for seed, against in enumerate((*named, lost))]
    publish(egos, path, "v0", date="2026-01-01")
    return load_registry(path)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 20)


def evaluate(robot: Any, registry: Registry, **options: Any) -> az.EvaluationResult:
    options = {"episodes": 1, "backend": "native", "references": False, **options}
    return az.evaluate(robot, task=TASK, zoo=az.open_zoo(registry.path), progress=False, **options)


def still(obs: np.ndarray) -> np.ndarray:
    return np.zeros((len(obs), 7), np.float32)


def humans(registry: Registry, side: tuple[str, ...], disability: str = "d") -> list[str]:
    return sorted(f"{team}/human" for team in side if f"-{disability}" in team)


def left_out(registry: Registry, robots: list[Any], split: str, trained_with: Any = None) -> Any:
    """Return the partners that an evaluation would leave out, and the robots' record."""
    egos = declare(read_egos(robots, registry, TASK), registry, TASK, trained_with)
    met = met_partners(egos, registry.select(task=TASK, role="human"))
    chosen = registry.split(TASK, split)
    sides = {entry.id: chosen.side(entry.team) for entry in registry.select(role="human")}
    return sorted(met.left_out(sides)), met


def of_kind(registry: Registry, name: str, kind: Format, folder: Path) -> Path:
    path = folder / f"robot.{'onnx' if kind == 'onnx' else 'safetensors'}"
    export_policy(name, kind, path, lambda: registry)
    return path


@pytest.fixture(scope="module")
def result(registry: Registry, tmp_path_factory: pytest.TempPathFactory) -> az.EvaluationResult:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assistax_envs.env.EPISODE_LENGTH", 20)
        out = tmp_path_factory.mktemp("results") / "ego"
        return evaluate(EGO, registry, split=f"{D1}:both", out=out)


def test_m_test_omits_training_partners(registry: Registry, result: az.EvaluationResult) -> None:
    """The ego was trained with half of the held-out setting."""
    half = registry.split(TASK)
    met = humans(registry, half.train, "d1")
    assert len(met) == 2
    assert result.met == MetSummary(known=True, source="registry", left_out=tuple(met))
    assert result.to_json()["met"] == {"known": True, "source": "registry", "left_out": met}
    assert result.m_test is not None and result.m_test.n == 2
    new = result.episodes.filter(pl.col("side") == "test", ~pl.col("partner").is_in(met))
    assert result.m_test.mean == pytest.approx(new["return"].mean())
    assert result.m_train is not None and result.m_train.n == 4
    [left] = [note for note in result.notes if "left out of the figures" in note]
    assert left.startswith("2 partners that one of the egos was trained with")
    assert half.id in left and all(name in left for name in met)
    assert any(note.startswith("M_train: 2 of 4 partners") for note in result.notes)
    assert "not known" not in repr(result)
    manifest = read_manifest(result.folder)
    assert manifest is not None and manifest["met"]["robots"][EGO]["split"]["split"] == half.id


def test_met_partners_count_on_the_training_side_alone() -> None:
    sides = {"a": "train", "b": "validation", "c": "test", "d": None, "e": "train", "f": "test"}
    met = MetPartners(("registry",), own=frozenset("e"), frozen=frozenset("abcd"))
    assert met.left_out(sides) == ["b", "c", "d", "e"]


def test_seeds_omit_partners_of_any_seed(registry: Registry) -> None:
    assert left_out(registry, [EGO], "half")[0] == []
    split = registry.split(TASK)
    own = f"{split.test[0]}/human"
    robot = az.open_zoo(registry.path).partner(split.test[0], role="robot")
    assert left_out(registry, [robot], "half")[0] == [own]
    left, met = left_out(registry, [EGO, f"{split.test[0]}/robot"], D1)
    assert left == sorted({*humans(registry, split.train, "d1"), own})
    assert met.known and not met.by_all


def test_ego_trained_with_test_side_is_refused(registry: Registry) -> None:
    met = humans(registry, registry.split(TASK).train, "d1")
    with pytest.raises(ValueError, match="every partner that matches was trained with one of"):
        evaluate(EGO, registry, split=D1, partners=met)
    new = humans(registry, registry.split(TASK, D1).train)[0]
    for robot, options in ((EGO, {}), (still, {"trained_with": "half"})):
        with pytest.raises(ValueError, match="every partner of the test side that matches"):
            evaluate(robot, registry, split=f"{D1}:both", partners=[*met, new], **options)


@pytest.mark.parametrize("kind", ["safetensors", "onnx"])
def test_exported_robot_claims_own_human(kind: Format, registry: Registry, tmp_path: Path) -> None:
    """The human is recognised under another id in another zoo."""
    team = registry.split(TASK).test[0]
    path = of_kind(registry, f"{team}/robot", kind, tmp_path)
    left, met = left_out(registry, [path], "half")
    assert left == [f"{team}/human"]
    assert met.sources == (("file",) if kind == "onnx" else ("registry",))
    human = registry.policy(f"{team}/human")
    renamed = dataclasses.replace(human, id="lab:x/human", team="lab:x")
    elsewhere = load_registry(published(teams_of(1), tmp_path / "other"))
    egos = read_egos([path], elsewhere, TASK)
    assert met_partners(egos, [renamed]).own == {"lab:x/human"}


def test_exported_ego_claims_split(registry: Registry, tmp_path: Path) -> None:
    path = of_kind(registry, EGO, "onnx", tmp_path)
    left, met = left_out(registry, [path], D1)
    assert left == humans(registry, registry.split(TASK).train, "d1")
    assert met.sources == ("file",) and registry.split(TASK).id in met.reasons[0]
    assert export_policy(EGO, "onnx", path, lambda: registry)["written"] is False
    claim = read_policy_file(of_kind(registry, EGO, "safetensors", tmp_path)).metadata["met"]
    registered = met_in_training(registry, registry.policy(EGO))
    assert Met.model_validate({"source": "registry", **claim}) == registered


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_a_published_robot_keeps_its_record_in_a_file(dtype: type, tmp_path: Path) -> None:
    """Claims of the file are ignored; parameters in half precision are known again too."""
    path = published(teams_of(4), tmp_path)
    half = load_registry(path).split(TASK)
    ego = trained_ego(0, {"split": half.id, "sha256": half.sha256})
    params = {"robot": jax.tree.map(lambda leaf: leaf.astype(dtype), ego.params["robot"])}
    publish([dataclasses.replace(ego, params=params)], path, "v0", date="2026-01-01")
    registry = load_registry(path)
    [stack] = registry.stacks([registry.policy(EGO)])
    forged = tmp_path / "mine.safetensors"
    write_policy_file(forged, ROBOT, stack.row(0), {"task": TASK, "met": {"partners": {}}})
    assert left_out(registry, [forged], "half")[1].sources == ("registry",)
    other = jax.tree.map(lambda leaf: leaf * np.float32(1.01), stack.row(0))
    write_policy_file(forged, ROBOT, other, {"task": TASK, "met": {"partners": {}}})
    assert left_out(registry, [forged], "half")[1].sources == ("file",)


def claimed(folder: Path, metadata: dict[str, Any]) -> Path:
    """Return the file of an unpublished robot with these metadata."""
    path = folder / "mine.safetensors"
    write_policy_file(path, ROBOT, params_of(ROBOT, 99), metadata)
    return path


@pytest.mark.parametrize("told", [False, True, "partner"])
def test_file_keeps_told_observations(registry: Registry, tmp_path: Path, told: bool | str) -> None:
    mine, graph = claimed(tmp_path, {"task": TASK, "told": told}), tmp_path / "mine.onnx"
    export_policy(str(mine), "onnx", graph, lambda: registry)
    assert [read_egos([path], registry, TASK).view.told for path in (mine, graph)] == [told] * 2


def test_older_files_name_policy_or_split(registry: Registry, tmp_path: Path) -> None:
    team, half = registry.split(TASK).test[0], registry.split(TASK)
    entry = registry.policy(f"{team}/robot")
    named = claimed(tmp_path, {"id": entry.id, "sha256": entry.sha256})
    assert left_out(registry, [named], "half")[0] == [f"{team}/human"]
    ego = claimed(tmp_path, {"task": TASK, "split": half.id})
    assert left_out(registry, [ego], D1)[0] == humans(registry, half.train, "d1")
    other = claimed(tmp_path, {"id": entry.id, "sha256": "0" * 64})
    assert not left_out(registry, [other], "half")[1].known


@pytest.mark.parametrize(
    "claim",
    [
        "\x1b[31mnobody",
        {"partners": {"scratch/ippo-d1-s0-v0": "no hash"}},
        {"own": ["scratch/ippo-d1-s0-v0"]},
        {"partners": {"x" * 300: "0" * 64}},
        {"source": "registry", "reason": "believe me"},
    ],
)
def test_a_malformed_claim_is_no_knowledge(claim: Any, registry: Registry, tmp_path: Path) -> None:
    _, met = left_out(registry, [claimed(tmp_path, {"met": claim})], "half")
    assert not met.known and "does not say it in a known form" in met.unknown[0]


def test_ego_of_unknown_split_has_no_record(registry: Registry) -> None:
    lost = registry.policy("scratch/ppo-ego-s2-v0/robot")
    assert "split 'scratch/half-s7-v0-01234567'" in met_in_training(registry, lost).reason
    _, met = left_out(registry, [lost.id], "half")
    assert not met.known and "is not in this registry" in met.unknown[0]
    half = TrainedAgainst(split=registry.split(TASK).id, sha256="0" * 64)
    forged = met_in_training(registry, dataclasses.replace(lost, trained_against=half))
    assert not forged.known and "has another sha256" in forged.reason


@pytest.mark.slow
def test_unknown_training_is_noted_everywhere(
    registry: Registry, tmp_path: Path, result: az.EvaluationResult
) -> None:
    unknown = evaluate(still, registry, split=f"{D1}:both", out=tmp_path / "a")
    assert unknown.met == MetSummary(known=False, source="not known", left_out=())
    assert "partners met in training: not known" in repr(unknown)
    assert any("partners met in training: not known" in note for note in unknown.notes)
    assert "partners met in training: not known" in unknown.report(tmp_path / "a.html").read_text()
    difference = az.compare(result, unknown)
    assert difference.met is not None and difference.met.left_out == result.met.left_out
    assert not difference.met.known
    assert difference.test is not None and difference.test.n == 2 * 2
    assert difference.train is not None and difference.train.n == 4 * 2
    assert any("left out of both" in note for note in difference.notes)
    options = {"trained_with": "half", "out": tmp_path / "b"}
    declared = evaluate(still, registry, split=f"{D1}:both", **options)
    assert declared.met == dataclasses.replace(result.met, source="declared")
    assert "partners met in training: as declared, not checked" in declared.notes
    assert "not known" not in repr(declared)
    manifest = read_manifest(tmp_path / "b")
    assert manifest is not None and manifest["met"]["declared"] == ["half"]
    # What is declared is about figures: the job, its episodes and their table are the same.
    assert manifest["job"] == (read_manifest(tmp_path / "a") or {})["job"]
    there, here = (tmp_path / name / tables.EPISODES_FILE for name in "ab")
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.parametrize(
    ("trained_with", "expected"),
    [
        ("nobody", []),
        ("half", None),
        ("scratch/ippo-d1-s0-v0", ["scratch/ippo-d1-s0-v0/human"]),
        (["scratch/ippo-d1-s[01]-v0/human"], [f"scratch/ippo-d1-s{s}-v0/human" for s in (0, 1)]),
    ],
)
def test_a_robot_of_ones_own_is_declared(
    trained_with: Any, expected: list[str] | None, registry: Registry
) -> None:
    if expected is None:
        expected = humans(registry, registry.split(TASK).train, "d1")
    left, met = left_out(registry, [still], D1, trained_with)
    assert left == expected
    assert met.known and met.sources == ("declared",)


def test_a_declaration_takes_nothing_away(registry: Registry) -> None:
    left, met = left_out(registry, [EGO], D1, "scratch/ippo-d1-*")
    assert left == [f"scratch/ippo-d1-s{seed}-v0/human" for seed in range(4)]
    assert met.sources == ("declared",)
    with pytest.raises(ValueError, match="was trained with partners of the zoo as its registry"):
        left_out(registry, [EGO], D1, "nobody")
    with pytest.raises(ValueError, match="'nobody' beside others"):
        left_out(registry, [still], D1, ["nobody", "half"])
    with pytest.raises(ValueError, match=r"trained_with is 'nobdy'; .* did you mean 'nobody'"):
        left_out(registry, [still], D1, "nobdy")
    with pytest.raises(ValueError, match="of task bed_bath, and scratch is played"):
        left_out(registry, [still], D1, "bed_bath/half")
    with pytest.raises(SplitError):
        left_out(registry, [still], D1, "halves")
    with pytest.raises(UnknownIdError):
        left_out(registry, [still], D1, "scratch/isac-*")


def test_a_python_module_declares_it(registry: Registry, tmp_path: Path) -> None:
    code = "def make():\n    return lambda obs: obs[:, :7]\n"
    module = tmp_path / "met_robot.py"
    module.write_text(f"TRAINED_WITH = ['half']\n{code}")
    left, met = left_out(registry, [f"python:{module}:make"], D1)
    assert left == humans(registry, registry.split(TASK).train, "d1")
    assert met.sources == ("declared",)
    for said, problem in (
        ("gentle_scratch/persons", "'gentle_scratch/persons', of task gentle_scratch, and scratch"),
        ("lab:bed_bath/ippo-*", "'lab:bed_bath/ippo-[*]', of task bed_bath, and scratch is played"),
        ("halves", "split 'halves' of task 'scratch': expected one split"),
        ("scratch/isac-*", "unknown policy 'scratch/isac-[*]'"),
    ):
        module.write_text(f"TRAINED_WITH = {said!r}\n{code}")
        with pytest.raises(EgoError, match=f"TRAINED_WITH of {module}: .*{problem}"):
            left_out(registry, [f"python:{module}:make"], D1)
    module.write_text(f"TRAINED_WITH = make = object()\n{code}")
    with pytest.raises(EgoError, match=r"TRAINED_WITH of .* expected a text or a list of texts"):
        read_egos([f"python:{module}:make"], registry, TASK)


def test_added_zoo_ego_met_own_partners(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The ego's split has the name and the sha256 of a split here, with other humans."""
    monkeypatch.setenv("ASSISTAX_ZOO_DATA", str(tmp_path / "data"))
    ours = [untrained_team("d1", s, human=(HUMAN, params_of(HUMAN, 900 + s))) for s in range(4)]
    ours += [untrained_team("d9", s, human=(HUMAN, params_of(HUMAN, 910 + s))) for s in range(4)]
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(published(ours, tmp_path / "ours")))
    from zoo.transport.other_zoos import add

    add(str(registry.path.parent), "lab")
    both = load_registry()
    assert both.split(TASK).sha256 == registry.split(TASK).sha256
    met = met_in_training(both, both.policy(f"lab:{EGO}"))
    assert met.known and sorted(met.partners) == [f"lab:{t}" for t in registry.split(TASK).train]
    first = registry.split(TASK).train[0]
    assert met.partners[f"lab:{first}"] == registry.policy(f"{first}/human").sha256


def test_crossplay_notes_training_partners(registry: Registry) -> None:
    team = registry.split(TASK).train[0]
    matrix = az.cross_play(
        [EGO], [team], task=TASK, episodes=1, backend="native", zoo=registry.path, progress=False
    )
    assert any("frozen partners of an ego" in note and team in note for note in matrix.notes)


@pytest.mark.parametrize("release", ["v0", "v1"])
def test_crossplay_uses_split_of_humans_release(release: str, tmp_path: Path) -> None:
    """Though another release is the task's default: the caption of a figure names the split."""
    teams = teams_of(2)
    registry = publish(teams, published(teams, tmp_path), "v1", date="2026-01-01")
    team = f"{TASK}/ippo-d1-s0-{release}"
    cast = cast_population(registry, TASK, f"{team}/robot", f"{team}/human")
    assert cast.split == registry.split(TASK, release=release)
    assert registry.release_of(TASK) == "v1"


def test_board_omits_egos_trained_with_panel(registry: Registry) -> None:
    """The second ego was trained with d9, of which two are on the half's test side."""
    rows = ZooCatalogue(registry, "native").references(TASK)
    assert "ppo-ego-s0-v0" in rows and "ppo-ego-s2-v0" in rows
    assert "ppo-ego-s1-v0" not in rows
