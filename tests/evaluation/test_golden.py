"""Episode tables on `native` stay, bit for bit, what they were when the golden folder was made.

Another processor, jaxlib or MuJoCo may round the last bit differently, and contacts amplify that:
there the same episodes must be played, and their returns agree in the mean.
"""

import json
from importlib.metadata import version
from pathlib import Path

import polars as pl
import pytest

from assistax_envs import make
from evaluation import tables
from evaluation.evaluator import run_job
from evaluation.jobs import Job
from evaluation.provenance import processor
from evaluation.relative import COLUMN, PASSIVE, SCRIPT
from evaluation.roster import registry_roster
from evaluation.studies import Settings, cross_play, evaluate_policies
from zoo.registry import load_registry

GOLDEN = Path(__file__).parent / "golden"
MADE_WITH = json.loads((GOLDEN / "made_with.json").read_text())


def same_machine() -> bool:
    here = {"processor": processor(), **{name: version(name) for name in ("jaxlib", "mujoco")}}
    return all(MADE_WITH[name] == value for name, value in here.items())


def assert_golden(found: Path, name: str) -> None:
    """Hold a table against the golden one of this name, every value of it."""
    table, golden = tables.read_parquet(found), tables.read_parquet(GOLDEN / f"{name}.parquet")
    assert table.schema == golden.schema
    if same_machine():
        differing = [
            column
            for column in golden.columns
            if not table[column].eq_missing(golden[column]).all()
        ]
        assert differing == []
        if version("polars") == MADE_WITH["polars"]:
            assert found.read_bytes() == (GOLDEN / f"{name}.parquet").read_bytes()
        return
    described = [*tables.EGO_COLUMNS, *tables.PARTNER_COLUMNS, "episode", "key"]
    assert table.select(described).equals(golden.select(described))
    assert table["return"].mean() == pytest.approx(golden["return"].mean(), rel=0.05)


@pytest.mark.slow
def test_an_evaluation_with_its_references(tmp_path: Path):
    """Two specs on either side of the table: each pair of specs is a program of its own."""
    evaluate_policies(
        load_registry(),
        ["zoo:scratch/ippo-d1-s0-v1/robot", "zoo:scratch/masac-d4-s1-v1/robot"],
        Settings("scratch", 2, seed=7, backend="native"),
        tmp_path / "out",
        split="both",
        partners=[
            "scratch/ippo-d2-s0-v1/human",
            "scratch/mappo-d9-s[01]-v1/human",
            "scratch/masac-d5-s[01]-v1/human",
        ],
        references=tmp_path / "kept",
    )
    assert_golden(tmp_path / "out" / tables.EPISODES_FILE, "evaluate")
    played = tables.read_parquet(tmp_path / "out" / tables.REFERENCES_FILE)
    newer = pl.col(COLUMN).is_in([SCRIPT, PASSIVE])  # came after the golden table was made
    assert played.filter(newer)["ego"].n_unique() == 3  # the script, and both robots
    tables.write_parquet(played.filter(~newer), tmp_path / "references.parquet")
    assert_golden(tmp_path / "references.parquet", "references")


@pytest.mark.slow
def test_a_crossplay_with_drawn_actions(tmp_path: Path):
    teams = "bed_bath/*-d3-s0-v1"
    settings = Settings("bed_bath", 2, backend="native", stochastic=True)
    cross_play(load_registry(), f"{teams}/robot", f"{teams}/human", settings, tmp_path)
    assert_golden(tmp_path / tables.EPISODES_FILE, "crossplay")


@pytest.mark.slow
def test_self_play_of_teams(tmp_path: Path):
    registry = load_registry()
    robots, humans = (
        registry_roster(registry, registry.select("arm_assist/[im]*ppo-d1-s[01]-v1", role=role))
        for role in ("robot", "human")
    )
    job = Job("arm_assist", 1, "native", robots, humans, episodes=2, seed=3, paired=True)
    run_job(make("arm_assist", backend="native"), job, tmp_path)
    assert_golden(tmp_path / tables.EPISODES_FILE, "paired")


@pytest.mark.parametrize("column", ["return", "force_peak", "ego_seed", "key", "steps"])
def test_the_check_sees_a_value_that_changed(tmp_path: Path, column: str):
    """Planted: the last bit of one value."""
    golden = pl.read_parquet(GOLDEN / "crossplay.parquet")
    kind = golden[column].dtype
    bits = golden[column].reinterpret(signed=False) if kind.is_integer() else golden[column]
    values = bits.to_numpy().copy()
    raw = values.view("uint8")
    raw[0] ^= 1
    changed = golden.with_columns(pl.Series(column, values).cast(kind))
    assert_golden(GOLDEN / "crossplay.parquet", "crossplay")
    changed.write_parquet(tmp_path / "episodes.parquet", compression="zstd")
    if same_machine() or column in ("ego_seed", "key"):
        with pytest.raises(AssertionError):
            assert_golden(tmp_path / "episodes.parquet", "crossplay")
