"""Evaluations with own teams and splits, and cross-plays of another zoo: as with official ones."""

from pathlib import Path
from typing import Any

import pytest

from assistax_workshop.press.publish import publish
from evaluation.play.how import PlaySettings
from evaluation.plots.crossplay.matrix import arrange
from evaluation.record import tables
from evaluation.record.verification import check_sources
from tests.attack.commands import HUMAN, ROBOT, small_zoo
from tests.evaluation.test_sources import toy
from tests.studies import cross_play, evaluate_policies
from tests.untrained import params_of, untrained_team
from zoo.locations import added_registry, own_registry
from zoo.registry import load_registry
from zoo.splitting.create import create_split
from zoo.transport.other_zoos import add

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """An official zoo; beside it own teams, an own split, and a lab's teams of the same names."""
    home = tmp_path_factory.mktemp("home")
    registry = small_zoo(home / "zoo")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("ASSISTAX_ZOO_REGISTRY", raising=False)
        patch.setenv("ASSISTAX_ZOO_DATA", str(home / "data"))
        patch.setenv("ASSISTAX_ZOO_CACHE", str(home / "cache"))
        for module in ("zoo.history.official", "zoo.locations"):
            patch.setattr(f"{module}.shipped_registry", lambda: registry)
        patch.setattr("assistax_envs.make", toy)
        # Untrained humans all act nearly alike.
        patch.setattr("zoo.splitting.create.similar_pairs", lambda registry, split: [])
        yield home


def teams(first: int) -> list[Any]:
    return [
        untrained_team(
            disability,
            seed,
            robot=(ROBOT, params_of(ROBOT, first + 10 * place + seed)),
            human=(HUMAN, params_of(HUMAN, first + 50 + 10 * place + seed)),
        )
        for place, disability in enumerate(("d1", "d9"))
        for seed in range(2)
    ]


def test_own_teams_and_splits_are_played_right_after(home: Path) -> None:
    split = create_split(task="scratch", rule="small-train", n=1)
    publish(teams(1000), own_registry(), "v0", date="2027-01-01")
    registry, settings = load_registry(), PlaySettings("scratch", 1, backend="native")
    robots = ["zoo:own:scratch/ippo-d1-s0-v0/robot"]
    evaluate_policies(registry, robots, settings, home / "mine", split=f"{split.id}:both")
    robots = ["scratch/ippo-d1-s0-v0/robot"]
    evaluate_policies(registry, robots, settings, home / "own", split="own:")
    own = registry.split("scratch", "own:").test
    for folder, expected in (("mine", (*split.train, *split.test)), ("own", own)):
        played = set(tables.read_episodes(home / folder / tables.EPISODES_FILE)["partner"])
        assert played == {f"{team}/human" for team in expected}
        report = check_sources(home / folder)
        assert (report.problems, report.absent) == ((), ())


def test_another_zoo_is_cross_played_under_its_name(home: Path) -> None:
    publish(teams(2000), home / "lab" / "registry.json", "v0", date="2027-01-01")
    add(str(home / "lab"), "lab")
    registry, settings = load_registry(), PlaySettings("scratch", 1, backend="native")
    for shard in registry.part("lab").data.shards:
        target = added_registry("lab").parent / shard
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((home / "lab" / shard).read_bytes())
    cross_play(registry, "lab:*", ["lab:*", "scratch/*-v0/human"], settings, home / "xp")
    pairs = tables.read_parquet(home / "xp" / tables.PAIRS_FILE)
    matrix = arrange(pairs)
    assert set(matrix.rows.names) == {f"lab:ippo-{d}-s{s}" for d in ("d1", "d9") for s in (0, 1)}
    assert {"lab:ippo-d1-s0", "ippo-d1-s0"} <= set(matrix.columns.names)
